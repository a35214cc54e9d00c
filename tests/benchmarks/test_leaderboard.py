import io
import math
import re

import numpy as np
import pytest
from rich.console import Console
from scipy import stats

from lidarnaut.agents.statistics import Estimate
from lidarnaut.benchmarks.arena import leaderboard
from lidarnaut.benchmarks.arena.episodes import Episodes, best_of
from lidarnaut.benchmarks.arena.measures import Measures, texts
from lidarnaut.benchmarks.arena.page import to_terminal
from lidarnaut.envs.measures import DOCK, EXPLORATION, GOAL, PEOPLE, REACH, ROUTE, SWEEP, TIME_TO_SUCCESS
from lidarnaut.evaluate_command import main
from tests.benchmarks.explorations import BY_NAME, MEASURES, read_rows, row, table

RATIO = BY_NAME["time_to_95_ratio"]


def everywhere(policy, area, time, **more):
    """Four starts in each of two worlds; the second world takes ten times as long."""
    return [
        row(policy, seed, world, area + 0.01 * seed, scale * time, scale * time / 2, **more)
        for world, scale in (("maze", 1.0), ("caves", 10.0))
        for seed in range(4)
    ]


ROWS = [
    *everywhere("oracle (ground truth)", 0.90, 50.0),
    *everywhere("nearest", 0.80, 100.0),
    *everywhere("quick", 0.85, 80.0),
    *everywhere("slow", 0.70, 150.0, explored=0.97),
]


def test_ratios_are_those_to_the_reference_from_the_same_starts():
    episodes = table([*ROWS, row("quick", 9)])  # nearest has no such start
    shares = {policy: episodes.estimate(policy, RATIO) for policy in episodes.policies}
    assert {policy: value.iqm for policy, value in shares.items()} == pytest.approx(
        {"oracle (ground truth)": 0.5, "nearest": 1.0, "quick": 0.8, "slow": 1.5}
    )
    assert {value.n for value in shares.values()} == {8}
    assert table([row("nearest", time=0.0), row("a", time=0.5)]).estimate("a", RATIO).iqm == 1.0  # all seen at once
    assert table(ROWS, "slow").estimate("quick", RATIO).iqm == pytest.approx(8 / 15)
    times = {"nearest": (100.0, math.inf, 0.2), "quick": (50.0, 2000.0, 0.0)}  # times below 1 s count as 1 s
    rows = [row(policy, k, time=time) for policy, each in times.items() for k, time in enumerate(each)]
    assert table(rows).estimate("quick", RATIO).iqm == pytest.approx(0.25 ** (1 / 3))  # geometric mean


def test_the_ranking_is_by_success_time_and_leaves_the_bound_out():
    episodes = table(ROWS)
    assert list(episodes.standing(MEASURES.decisive)) == ["quick", "nearest", "slow", "oracle (ground truth)"]
    (section,) = leaderboard.ranking_sections(episodes)
    head, lines = section.parts[1].head, section.parts[1].lines
    assert [line[0].text for line in lines] == ["1: quick", "2: nearest", "3: slow", "bound: oracle (ground truth)"]
    quick, slow = ({title: cell.text for title, cell in zip(head, line)} for line in (lines[0], lines[2]))
    assert episodes.estimate("quick", BY_NAME["area_under_curve"]).iqm == pytest.approx(0.865)  # of 0.85 to 0.88, twice
    assert (quick["area under curve %"], quick["time to 95 %, ratio"], quick["success %"]) == ("86.5", "0.80", "100")
    assert slow["time to success, ratio"] == "never"  # it explored 97 %
    assert [cell.text for cell in lines[0] if cell.is_best] == ["0.80", "0.80", "0.80", "86.5"]
    assert not any(cell.is_best for line in lines[1:] for cell in line)


def test_only_values_with_intervals_apart_are_marked():
    measure = BY_NAME["area_under_curve"]
    values = {
        "a": Estimate(0.9, 0.85, 0.95, 8),
        "b": Estimate(0.8, 0.75, 0.86, 8),
        "o (ground truth)": Estimate(1.0, 1.0, 1.0, 8),
    }
    assert best_of(values, measure) == ""
    values["b"] = Estimate(0.8, 0.75, 0.84, 8)
    assert best_of(values, measure) == "a"
    assert best_of({**values, "b": values["b"]._replace(n=4)}, measure) == ""
    assert best_of({"a": values["a"]}, measure) == best_of(values, BY_NAME["path_length"]) == ""


def test_only_starts_that_all_competitors_share_count():
    rows = [row("a", 0), row("a", 1), row("b", 1), row("b", 2), row("oracle (ground truth)", 3)]
    assert [(r["policy"], r["seed"]) for r in Episodes(rows, MEASURES).shared()] == [("a", 1), ("b", 1)]
    assert not Episodes([row("a", 0), row("b", 1)], MEASURES).shared()


def test_episodes_are_named_by_what_differs_and_typical_is_the_median():
    rows = [row("a", k, area=area) for k, area in enumerate([0.9, 0.1, 0.5])]
    assert [r["area_under_curve"] for r in Episodes(rows, MEASURES).typical_and_worst("a")] == [0.5, 0.1]
    rows = [row("a"), row("a", slam="truth"), row("a", world="caves", robot="create3")]
    assert list(Episodes(rows, MEASURES).labels.values()) == ["maze, tinyslam", "maze, truth", "caves"]


@pytest.mark.parametrize(
    ("own", "brief"),
    [
        (EXPLORATION, ["success", "time_to_success", "time_to_95", "distance_to_95"]),
        ((*REACH, *PEOPLE), ["success", "sct", "time_to_goal", "collisions"]),
        (GOAL, ["success", "spl", "time_to_goal", "collisions"]),
        (ROUTE, ["success", "progress", "time_to_end", "collisions"]),
        ((TIME_TO_SUCCESS,), ["success", "time_to_success", "collisions"]),
    ],
    ids=["explore", "reach", "goal", "route", "default"],
)
def test_four_measures_are_printed_in_the_order_of_the_task(own, brief):
    assert [measure.name for measure in Measures(own, "progress").brief] == brief


def test_leaderboards_have_the_measures_that_decide():
    shown = Measures((*REACH, *PEOPLE), "progress").shown
    names = ["success", "sct", "time_to_goal", "collisions", "hit_person", "intrusion_time", "spl", "barn_metric"]
    assert [measure.name for measure in shown] == names
    assert max(len(Measures(own, "progress").shown) for own in (DOCK, (*DOCK, *PEOPLE), EXPLORATION, ROUTE, SWEEP)) <= 8


def test_the_table_of_a_single_world_fits_120_columns_of_a_terminal():
    measures = Measures((*REACH, *PEOPLE), "progress")
    names = "pursuit", "ppo:runs/reach_house", "learned:pretrained/crowd"
    values = {measure.name: 0.5 for measure in measures.all} | {"time_limit": 100.0}
    rows = [row(policy, k) | values | {"time_to_goal": 50.0 if k else math.inf} for policy in names for k in range(5)]
    console = Console(file=io.StringIO(), width=400)
    console.print(to_terminal(leaderboard.ranking_table(Episodes(rows, measures), measures.brief), "5 starts"))
    lines = console.file.getvalue().splitlines()
    assert 60 < max(map(len, lines)) <= 120
    assert len([line for line in lines if " to > " in line]) == 3


def test_an_axis_is_compared_pair_by_pair():
    rows = [
        row("a", seed, slam=slam, area=area, time=time * (seed + 1))
        for slam, area, time in (("tinyslam", 0.7, 120.0), ("truth", 0.8, 100.0), ("odometry", 0.2, 300.0))
        for seed in range(4)
    ]
    rows += [row("a", 7, slam="tinyslam", area=0.0), row("a", 0, world="caves"), row("b", 0, world="caves")]
    section = leaderboard.axis_section(Episodes(rows, MEASURES), "slam")
    text, (head, lines, *_) = section.parts
    assert section.title == "What mapping error costs"
    assert "from the same starts." in text
    assert head[1:4] == ("success %", "area under curve %", "position error cm")
    ratios = "time to 95 %, ratio to truth's", "distance to 95 %, ratio to truth's"
    assert head[5:] == (*ratios, "area under curve %, difference to truth")
    shown = {line[0].text: [cell.text for cell in line[1:]] for line in lines}
    assert list(shown) == ["a, truth", "a, tinyslam", "a, odometry"]
    assert [cells[1] for cells in shown.values()] == ["80.0", "70.0", "20.0"]
    assert shown["a, truth"][4:] == ["-", "-", "-"]
    assert shown["a, tinyslam"][4:] == ["1.20", "1.00", "-10.0"]
    assert shown["a, odometry"][4] == "3.00"
    assert leaderboard.axis_section(Episodes(rows, MEASURES), "physics") is None


def test_what_was_not_finished_is_listed_with_why():
    rows = [
        row("a", 0),
        row("a", 1, explored=0.97, end_reason="no_reachable_frontier", area_left=2.0),
        row("a", 2, explored=0.5, end_reason="time_limit", area_left=8.0, position_rmse=0.9),
        row("b", 0, explored=0.98, end_reason="stuck", area_left=1.0),
    ]
    table = leaderboard.unfinished_section(Episodes(rows, MEASURES)).parts[1]
    assert [[cell.text for cell in line] for line in table.lines] == [
        ["a", "maze", "3", "2", "no reachable frontier (1); time limit, and the map had drifted (1)"],
        ["b", "maze", "1", "1", "stuck (1)"],
    ]
    (text,) = leaderboard.unfinished_section(Episodes(rows[:1], MEASURES)).parts
    assert text == "No episode failed."


def reached_in(policy, *times):
    limited = {"time_limit": 400.0, "distance_limit": 400.0}
    return [row(policy, k, time=t, explored=1.0 if t < math.inf else 0.5, **limited) for k, t in enumerate(times)]


def test_worlds_tell_how_many_reached_the_mark():
    rows = [*reached_in("a", 60.0, 80.0, math.inf), *reached_in("b", math.inf, math.inf, math.inf)]
    rows += reached_in("c", 400.0, 400.0, 400.0)
    ((name, *cells),) = leaderboard.worlds_section(Episodes(rows, MEASURES)).parts[1].lines
    assert name.text == "maze"
    assert [(cell.text, cell.note) for cell in cells] == [
        ("> 180.0 s", "60.0 to > 400.0*"),
        ("never", "> 400.0 s"),
        ("400.0", ""),
    ]


def test_what_was_never_reached_does_not_look_reached():
    rows = [*reached_in("nearest", 100.0, 200.0), *reached_in("a", math.inf, 400.0), *reached_in("b", *[math.inf] * 2)]
    shown = {policy: texts(RATIO, table(rows).estimate(policy, RATIO)) for policy in "ab"}
    assert shown == {"a": ("> 2.83", "2.00 to 4.00; only 2 starts"), "b": ("never", "> 2.83")}
    rows = [*reached_in("a", 100.0, *[math.inf] * 7)]
    time = BY_NAME["time_to_95"]
    assert texts(time, Episodes(rows, MEASURES).estimate("a", time)) == ("> 400 s", "1 of 8")
    # If the reference never reached the fraction, its time limit is the unit.
    rows = [*reached_in("nearest", math.inf), *reached_in("a", 100.0)]
    assert table(rows).estimate("a", RATIO).iqm == pytest.approx(0.25)


def test_the_published_numbers_are_those_of_the_table(tmp_path):
    docs = tmp_path / "docs"
    options = ["--policies", "oracle", "nearest", "frontier", "--worlds", "pimouse_arena", "turtlebot3_dqn_stage1"]
    options += ["--episodes", "2", "--physics", "kinematic", "--time-limit", "6", "--slam", "truth", "odometry"]
    assert main([*options, "--out", str(tmp_path / "out"), "--publish", str(docs)]) == 0
    page = (docs / "arena.md").read_text()
    rows = read_rows(docs / "arena")
    assert len(rows) == 24
    lines = [line.replace("*", "").strip("| ").split(" | ") for line in page.splitlines() if line.startswith("|")]
    ranking = page.partition("## Leaderboard")[2].partition("<details>")[0].replace("*", "").replace("bound: ", "")
    ranked = [line.strip("| ").split(" | ") for line in ranking.splitlines() if line.startswith("|")]
    shown = {line[0]: line[1:] for line in ranked}
    seconds = next(line[1:] for line in lines if line[0] == r"pimouse\_arena, truth")
    for policy, cell in zip(("oracle (ground truth)", "nearest", "frontier"), seconds, strict=True):
        mine = [r for r in rows if r["policy"] == policy]
        areas, fractions = ([float(r[name]) for r in mine] for name in ("area_under_curve", "explored_fraction"))
        expected = (
            stats.trim_mean(areas, 0.25),
            stats.trim_mean(fractions, 0.25),
            np.mean([int(r["success"]) for r in mine]),
        )
        numbers = [float(re.search(r"[-\d.]+", shown[policy][k]).group()) for k in (4, 5, 0)]
        assert (np.abs(numbers - 100 * np.array(expected)) <= (0.051, 0.051, 0.51)).all()
        here = [r for r in mine if r["world"] == "pimouse_arena" and r["slam"] == "truth"]
        times = [float(r["duration"] if r["success"] == "1" else r["time_limit"]) for r in here]
        assert float(re.search(r"[\d.]+", cell).group()) == pytest.approx(stats.trim_mean(times, 0.25), abs=0.051)
    assert "## What mapping error costs" in page
    assert "nearest, odometry" in page
    pictures = re.findall(r"\]\((arena/[^)]+)\)", page)
    assert "## At a glance" in page[: page.index("## Leaderboard")]
    assert len(pictures) == 1 + 2 + 2 * 3
    assert all((docs / picture).read_bytes().startswith(b"\x89PNG") for picture in pictures)
    names = {f"arena/{path.name}" for path in (docs / "arena").iterdir()}
    assert names == {*pictures, "arena/episodes.csv"}

import io
import re

import numpy as np
import pytest
from PIL import Image

from benchmarks.arena.leaderboard import ranking_section
from benchmarks.arena.overview import worst_section
from benchmarks.arena.pairs import relate
from benchmarks.arena.verdict import verdict, verdict_section
from tests.benchmarks.explorations import COLUMNS, MEASURES

DEFAULTS = {str: "x", int: 0, float: 0.0}
STARTS = 8


def episodes(policy, times, area=0.8, limit=1000.0):
    """Episodes from the same starts; an infinite time never reached 95 %."""
    for seed, time in enumerate(times):
        row = {name: DEFAULTS[read] for name, read in COLUMNS.items()}
        row |= {"policy": policy, "world": "maze", "seed": seed, "area_under_curve": area, "end_reason": "covered"}
        row |= {"time_to_95": time, "time_limit": limit, "distance_to_95": time, "distance_limit": limit}
        yield row | {"explored_fraction": 1.0 if np.isfinite(time) else 0.5}


def say(**policies):
    return verdict(
        relate([row for policy, times in policies.items() for row in episodes(policy, times)], MEASURES), MEASURES
    )


BASE = np.full(STARTS, 100.0)
SPREAD = np.linspace(-4.0, 4.0, STARTS)


def test_a_clear_winner_stands_beside_the_best_classic_explorer_and_the_bound():
    bound = {"mine (ground truth)": 0.5 * BASE}
    text = say(**bound, nearest=BASE, frontier=90.0 + SPREAD, rrt=95.0 + SPREAD, mine=80.0 + SPREAD)
    share = r"0\.80 \[0\.7\d, 0\.8\d\]"
    assert re.match(rf"mine is fastest: 95 % in {share} of nearest's time over 8 starts; the best classic", text)
    assert "the best classic policy, frontier, needs 0.90 [" in text
    assert "the bound, mine (ground truth), is 0.50." in text
    assert "cannot be told apart" not in text


def test_what_differs_from_start_to_start_only_is_not_told_apart():
    text = say(nearest=BASE, frontier=81.0 - SPREAD, rrt=95.0 + SPREAD, mine=80.0 + SPREAD)
    assert text.startswith("mine is ahead: 95 % in 0.80 [")
    assert "it cannot be told apart from frontier (0.81 [" in text
    assert "rrt" not in text
    # Their intervals overlap as much, but from every start the one is faster by as much.
    paired = say(nearest=BASE, frontier=81.0 + SPREAD, mine=80.0 + SPREAD)
    assert paired.startswith("mine is fastest")


def test_many_that_cannot_be_told_apart_are_counted():
    same = {name: 80.0 - (k + 1) * 0.01 * SPREAD + 0.001 * k for k, name in enumerate("abcde")}
    text = say(nearest=BASE, mine=80.0 + SPREAD, **same)
    assert re.search(r"cannot be told apart from \w \(.*\), \w \(.*\), \w \(.*\) and 2 more", text)


def test_the_reference_may_win_and_nobody_may():
    text = say(nearest=BASE, frontier=110.0 + SPREAD)
    assert text.startswith("nearest is fastest: no other needs less than its time to 95 % over 8 starts; the next")
    never = np.full(STARTS, np.inf)
    assert say(nearest=never, frontier=never) == (
        "No policy reached 95 % from any of the 8 starts within the time limit."
    )
    rows = relate([*episodes("nearest", never), *episodes("frontier", never)], MEASURES)
    assert len(verdict_section(rows, MEASURES).parts) == 1
    assert verdict_section(relate(list(episodes("nearest", BASE)), MEASURES), MEASURES) is None


def test_what_no_training_saw_comes_first():
    unseen, seen = "turtlebot3_house", "rrt_house"
    rows = []
    for world, share in ((unseen, 0.9), (seen, 0.5)):
        times = {"nearest": BASE, "gain_over_cost": 0.85 * BASE + SPREAD, "mine": share * BASE + SPREAD}
        for policy, values in times.items():
            rows += [
                row | {"world": world, "model": "" if policy != "mine" else "ab"} for row in episodes(policy, values)
            ]
    text, figure = verdict_section(relate(rows, MEASURES), MEASURES).parts
    first, pooled = text.split(" With those of the training: ")
    assert first.startswith(
        "In worlds or with robots that no training of the package saw: gain_over_cost is fastest: 95 % in 0.85"
    )
    assert f"over {STARTS} starts" in first
    assert pooled.startswith("mine is fastest: 95 % in 0.70")
    assert f"over {2 * STARTS} starts" in pooled
    assert "that no training of the package saw" in figure.caption
    _, unseen_table, all_table = ranking_section(relate(rows, MEASURES), MEASURES).parts
    assert [line[1].text for line in unseen_table.lines] == [line[1].text for line in all_table.lines]
    assert unseen_table.lines != all_table.lines
    assert all_table.title.startswith(f"All {2 * STARTS} starts")
    # Where nothing was learned, all starts are alike.
    classic = relate([row | {"model": ""} for row in rows], MEASURES)
    assert not verdict_section(classic, MEASURES).parts[0].startswith("In worlds")
    assert len(ranking_section(classic, MEASURES).parts) == 2


def test_another_order_by_area_is_said():
    rows = [*episodes("nearest", BASE, 0.9), *episodes("frontier", 0.8 * BASE, 0.8)]
    assert verdict(relate(rows, MEASURES), MEASURES).endswith(
        "By area under curve, which the leaderboard is ranked by, nearest comes first."
    )


@pytest.mark.parametrize("slowest", [120.0, 700.0, np.inf])
def test_the_picture_holds_all_of_its_labels(slowest):
    rows = relate(
        [*episodes("nearest", BASE), *episodes("mine", 0.8 * BASE), *episodes("slow", [slowest] * STARTS)], MEASURES
    )
    text, figure = verdict_section(rows, MEASURES).parts
    assert text.startswith("mine is fastest")
    pixels = np.asarray(Image.open(io.BytesIO(figure.picture.light)).convert("L"))
    assert pixels[:, [0, -1]].min() > 240  # nothing is cut off
    assert pixels[[0, -1]].min() > 240


def test_the_worst_episodes_are_those_that_lose_most_of_the_reference(monkeypatch):
    monkeypatch.setattr("benchmarks.arena.overview.NUM_WORST_MAPS", 0)  # which need traces
    times = [50.0, 150.0, 80.0, np.inf, 120.0, 90.0, 70.0, 60.0]
    rows = relate([*episodes("nearest", BASE), *episodes("mine", times)], MEASURES)
    section = worst_section(None, rows, MEASURES)
    assert section.title == "Where mine does worst"
    lines = section.parts[1].lines
    assert [line[0].text for line in lines] == [f"maze, seed {seed}" for seed in (3, 1, 4, 5, 2)]
    assert [line[1].text for line in lines] == ["never", "150", "120", "90", "80"]
    assert (lines[0][1].note, lines[1][3].text) == ("> 1000 s", "1.50")
    assert worst_section(None, relate(list(episodes("nearest", BASE)), MEASURES), MEASURES) is None

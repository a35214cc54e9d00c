"""The comparison of teams of different sizes."""

import math

import numpy as np
import pytest

from benchmarks import team
from envs.core import LidarEnv
from envs.tasks.explore import ExploreTeam


def rows_of(times):
    """Rows of one robot and of two, from two starts."""
    names = {"world": "rooms", "robot": "tugbot", "physics": "kinematic", "slam": "tinyslam", "time_limit": 600.0}
    starts = [(num, seed) for num in ("1", "2") for seed in (1, 0)]
    return [
        {**names, "policy": num, "seed": seed, "time_to_95": time, "path_length": 10.0, "collisions": 0.0}
        for (num, seed), time in zip(starts, times, strict=True)
    ]


def test_speed_ups_are_taken_pair_by_pair():
    rows = rows_of([100.0, 300.0, 80.0, 100.0])
    # 300 / 100 and 100 / 80, not the ratio of the means.
    assert team.speed_up(rows, 2).iqm == pytest.approx((3.0 + 1.25) / 2)
    assert team.speed_up(rows, 1).iqm == 1.0


@pytest.mark.parametrize(
    ("times", "shown", "ratio"),
    [
        ([math.inf, math.inf, 100.0, 100.0], ["never [> 600 s]", "100 [100 to 100]"], "> 6.00 [never]"),
        ([100.0, 300.0, math.inf, math.inf], ["200 [100 to 300]", "never [> 600 s]"], "0.33 [0.17 to 0.50]"),
    ],
)
def test_marks_that_were_never_reached_are_shown_as_such(times, shown, ratio):
    cells = [list(column.cells) for column in team.table(rows_of(times), (1, 2)).columns]
    assert cells[2] == shown
    assert cells[3][1] == ratio
    assert cells[4] == [f"{sum(map(math.isfinite, times[k : k + 2]))} of 2" for k in (0, 2)]


def test_teams_of_all_sizes_are_evaluated_from_the_same_starts_and_only_once(tmp_path, monkeypatch, capsys):
    arguments = {"worlds": ("pimouse_arena",), "robots": (1, 2), "episodes": 1, "jobs": 1, "slam": "truth"}
    team.main(**arguments, out=tmp_path)
    first = capsys.readouterr().out
    monkeypatch.setattr("benchmarks.arena.workers.run_episode", lambda *_: pytest.fail("was run again"))
    team.main(**arguments, out=tmp_path)
    assert capsys.readouterr().out == first
    assert first.count("1 of 1") == 2


def test_the_picture_has_a_trail_per_robot():
    env = LidarEnv(ExploreTeam, world="turtlebot3_world", num_robots=3, physics="kinematic")
    env.reset(seed=0)
    for _ in range(20):
        env.step(np.full((3, 2), 0.5, dtype=np.float32))
    figure = team.draw(env, env.time)
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert [label.split(",")[0] for label in labels] == ["robot 0", "robot 1", "robot 2"]
    assert len({line.get_color() for line in figure.axes[0].lines if line.get_label() in labels}) == 3

"""The comparison of teams of different sizes."""

import csv
import math

import numpy as np
import pytest

from baselines.episode import Episode
from benchmarks import team
from envs.core import LidarEnv
from envs.measures import Course
from envs.tasks.explore import ExploreTeam

TASKS = [("rooms", num, seed, "kinematic", "tinyslam") for num in (1, 2) for seed in (1, 0)]


def rows_of(times):
    names = ("world", "num_robots", "seed", "physics", "slam")
    return [
        dict(zip(names, task, strict=True))
        | {"time_to_95": time, "time_limit": 600.0, "explored_fraction": 0.96 if math.isfinite(time) else 0.9}
        for task, time in zip(TASKS, times, strict=True)
    ]


def test_speed_ups_are_taken_pair_by_pair():
    rows = rows_of([100.0, 300.0, 80.0, 100.0])
    np.testing.assert_array_equal(team.values(rows, "time_to_95", "rooms", 1), [300.0, 100.0])
    # 300 / 100 and 100 / 80, not the ratio of the means.
    assert team.speed_up(rows, ("rooms",), 2).iqm == pytest.approx((3.0 + 1.25) / 2)
    assert team.speed_up(rows, ("rooms",), 1).iqm == 1.0


@pytest.mark.parametrize(
    ("times", "shown", "ratio"),
    [
        ([math.inf, math.inf, 100.0, 100.0], ["never [> 600 s]", "100 [100 to 100]"], "> 6.00 [never]"),
        ([100.0, 300.0, math.inf, math.inf], ["200 [100 to 300]", "never [> 600 s]"], "0.33 [0.17 to 0.50]"),
    ],
)
def test_marks_that_were_never_reached_are_shown_as_such(times, shown, ratio):
    rows = [row | {"path_length": 10.0, "collisions": 0} for row in rows_of(times)]
    cells = [list(column.cells) for column in team.table(rows, ("rooms",), (1, 2)).columns]
    assert cells[2] == shown
    assert cells[3][1] == ratio
    assert cells[4] == [f"{sum(map(math.isfinite, times[k : k + 2]))} of 2" for k in (0, 2)]


def test_episodes_that_are_in_the_file_are_not_run_again(tmp_path, monkeypatch):
    path = tmp_path / "episodes.csv"
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, team.COLUMNS)
        writer.writeheader()
        writer.writerows(rows_of([100.0, 300.0, 80.0, 100.0]))
    monkeypatch.setattr(team, "measure", lambda *task: pytest.fail(f"{task} was run again"))
    rows = team.run(TASKS[:2], 1, path)
    assert [(row["num_robots"], row["seed"]) for row in rows] == [(1, 1), (1, 0)]
    assert team.values(rows, "time_to_95", "rooms", 1).tolist() == [300.0, 100.0]


def test_a_file_with_other_columns_is_refused(tmp_path):
    path = tmp_path / "episodes.csv"
    path.write_text(",".join(name for name in team.COLUMNS if name != "area_left") + "\n")
    with pytest.raises(ValueError, match="other columns"):
        team.run(TASKS[:1], 1, path)


def test_an_episode_is_laid_out_as_a_row(monkeypatch):
    names = ("time_to_95", "time_to_90", "explored_fraction", "area_left", "position_rmse")
    values = {name: float(k) for k, name in enumerate(names)} | {"path_length": 7.0, "collisions": 1.0}
    course = Course({}, {"path_length": np.array([3.0, 4.0])}, 600.0, 0.2)
    episode = Episode(values, course, np.ones(3), "covered", 90.0, 600.0, 120.0)
    monkeypatch.setattr(team, "run_episode", lambda *_: episode)
    row = team.measure(*TASKS[2])
    assert tuple(row) == team.COLUMNS
    assert tuple(row.values())[:5] == TASKS[2]
    assert row["area_left"] == episode.area_left
    assert (row["path_length"], row["longest_path"], row["collisions"]) == (7.0, 4.0, 1)


def test_the_picture_has_a_trail_per_robot():
    env = LidarEnv(ExploreTeam, world="turtlebot3_world", num_robots=3, physics="kinematic")
    env.reset(seed=0)
    for _ in range(20):
        env.step(np.full((3, 2), 0.5, dtype=np.float32))
    figure = team.draw(env, env.time)
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert [label.split(",")[0] for label in labels] == ["robot 0", "robot 1", "robot 2"]
    assert len({line.get_color() for line in figure.axes[0].lines if line.get_label() in labels}) == 3

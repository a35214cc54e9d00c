"""The navigation benchmark: what it makes of drives, and that its command runs."""

import json

import numpy as np
import pytest

from baselines.episode import Episode
from benchmarks.navigation import Drive, main, summary
from envs.measures import Course


def drive(seed=0, end_reason="reached", collisions=0, duration=20.0):
    course = Course({"way_to_goal": np.array([4.0, 0.0])}, {}, 60.0, 0.5)
    values = {"collisions": collisions, "path_length": 4.4, "position_rmse": 0.03, "heading_rmse": 0.01}
    return Drive(seed, Episode(values, course, np.ones(3), end_reason, duration, 60.0, 30.0), recoveries=1)


def test_only_goals_reached_without_a_touch_count():
    drives = [drive(), drive(1, collisions=2), drive(2, "lost"), drive(3, duration=40.0)]
    measures = summary(drives, max_v=0.5)
    assert measures["reached_without_collision_percent"] == 50.0
    assert measures["end_reasons"] == {"reached": 3, "lost": 1}
    assert measures["with_collision"] == 1
    assert measures["failed_seeds"] == [1, 2]
    assert measures["time_median_s"] == 30.0
    assert measures["share_of_full_speed_percent"] == pytest.approx(100.0 * 8.0 / (60.0 * 0.5))
    assert measures["path_over_way"] == pytest.approx(1.1)


def test_the_command_writes_what_it_measured(tmp_path):
    path = tmp_path / "navigation.json"
    main(worlds=("turtlebot3_dqn_stage1",), goals=2, jobs=1, physics="kinematic", json=path)
    measures = json.loads(path.read_text())["turtlebot3_dqn_stage1"]
    assert measures["goals"] == 2
    assert measures["reached_without_collision_percent"] == 100.0
    for cost in ("astar_across_us", "smooth_across_us", "is_path_valid_us", "take_a_scan_us", "control_us"):
        assert measures[cost] > 0.0

import json
import math

import numpy as np
import pytest

from benchmarks.localization.__main__ import main, time_quantile
from benchmarks.localization.maps import load_known_world, record_from_anywhere, symmetries
from benchmarks.localization.runs import time_of_success
from benchmarks.recorded_drives import Drive
from envs.geometry import OccupancyGrid


def test_one_run_and_its_json(tmp_path, capsys):
    path = tmp_path / "localization.json"
    main(path, runs=1, jobs=1, worlds=("turtlebot3_world",), only_runs=True, first_seed=900)
    measures = json.loads(path.read_text())["turtlebot3_world"]
    assert measures["tracking_rmse_m"] < 0.03
    assert measures["tracking_rmse_deg"] < 0.7
    assert measures["global_success_up_to_symmetry"] >= measures["global_success"]
    assert 0 <= measures["confident_and_wrong_share"] < 0.5
    assert "tracking_rmse_m" in capsys.readouterr().out


def test_a_drive_is_what_the_robot_saw_and_is_repeatable():
    setup = load_known_world("turtlebot3_world").setup
    one, same = (record_from_anywhere(setup, np.random.SeedSequence(4), 2.0) for _ in range(2))
    assert one.ranges.tobytes() == same.ranges.tobytes()
    assert one.truth.shape == one.motions.shape == (21, 3)
    np.testing.assert_array_equal(one.motions[0], 0.0)
    length = np.hypot(*np.diff(one.truth[:, :2], axis=0).T).sum()
    assert np.hypot(*one.motions[:, :2].T).sum() == pytest.approx(length, rel=0.1)


def test_kidnapping_joins_two_drives():
    one = Drive(np.zeros((5, 2)), np.ones((5, 3)), np.zeros((5, 3)))
    two = Drive(np.ones((4, 2)), np.zeros((4, 3)), np.ones((4, 3)))
    joined = one.then(two, 3)
    np.testing.assert_array_equal(joined.truth[:, 0], [0, 0, 0, 1, 1, 1, 1])
    np.testing.assert_array_equal(joined.motions[:, 0], [1, 1, 1, 0, 0, 0, 0])
    assert len(joined.ranges) == 7


def test_what_the_robot_cannot_see_is_unknown_on_its_map():
    setup, grid = load_known_world("turtlebot3_house")
    assert grid.data[0, 0] == -1
    row, col = grid.cells(np.array(setup.world.spawns[0][:2]))
    assert grid.data[row, col] == 0


def test_symmetries_of_a_rectangle_and_of_an_l():
    data = np.full((60, 90), -1, dtype=np.int8)
    data[10:50, 10:80] = 100
    data[12:48, 12:78] = 0
    (half_turn,) = symmetries(OccupancyGrid(data, 0.05, (1.0, 2.0)))
    assert abs(half_turn.theta) == pytest.approx(math.pi)
    np.testing.assert_allclose(half_turn.transform(np.array([[1.6, 2.6]])), [[4.9, 4.4]], atol=0.06)
    data[30:, 50:] = -1
    data[30, 50:80] = data[30:50, 50] = 100
    assert symmetries(OccupancyGrid(data, 0.05, (1.0, 2.0))) == []


def test_times_that_were_never_reached_are_infinite_or_none():
    never = np.zeros(600, dtype=bool)
    late = never.copy()
    late[100:] = True
    assert time_of_success(never) == math.inf
    assert time_of_success(late) == pytest.approx(10.0)
    assert time_quantile([1.0, 3.0, math.inf], 0.5) == 3.0
    assert time_quantile([1.0, 2.0, 3.0, math.inf], 0.5) == 2.5
    assert time_quantile([1.0, math.inf, math.inf], 0.5) is None

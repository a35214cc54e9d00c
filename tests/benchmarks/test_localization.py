import json
import math

import numpy as np
import pytest

from benchmarks.localization.__main__ import main
from benchmarks.localization.drives import Drive, load_place, record, symmetries
from benchmarks.localization.runs import errors
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
    place = load_place("turtlebot3_world")
    one, same = (record(place, np.random.SeedSequence(4), 2.0, "kinematic") for _ in range(2))
    assert one.ranges.tobytes() == same.ranges.tobytes()
    assert one.truth.shape == one.motions.shape == (21, 3)
    np.testing.assert_array_equal(one.motions[0], 0.0)
    way = np.hypot(*np.diff(one.truth[:, :2], axis=0).T).sum()
    assert np.hypot(*one.motions[:, :2].T).sum() == pytest.approx(way, rel=0.1)


def test_carrying_off_joins_two_drives():
    one = Drive(np.zeros((5, 2)), np.ones((5, 3)), np.zeros((5, 3)))
    two = Drive(np.ones((4, 2)), np.zeros((4, 3)), np.ones((4, 3)))
    joined = one.then(two, 3)
    np.testing.assert_array_equal(joined.truth[:, 0], [0, 0, 0, 1, 1, 1, 1])
    np.testing.assert_array_equal(joined.motions[:, 0], [1, 1, 1, 0, 0, 0, 0])
    assert len(joined.ranges) == 7


def test_what_the_robot_cannot_see_is_unknown_on_its_map():
    place = load_place("turtlebot3_house")
    assert place.grid.data[0, 0] == -1
    row, col = place.grid.cells(np.array(place.world.spawns[0][:2]))
    assert place.grid.data[row, col] == 0


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


def test_errors_wrap_headings():
    distance, angle = errors(np.array([[3.0, 4.0, 3.1]]), np.array([[0.0, 0.0, -3.1]]))
    assert distance == pytest.approx([5.0])
    assert angle == pytest.approx([2 * math.pi - 6.2])

import numpy as np

from lidarnaut.envs.geometry import OccupancyGrid, Pose2D
from lidarnaut.envs.navigation import CostmapParams, make_costmap, travel_field
from lidarnaut.envs.navigation.teams.team_robot import find_waiting_cell, is_beside, outline
from tests.rooms import BURGER


def test_a_waiting_cell_lies_off_the_path_and_on_the_own_side_of_it():
    data = np.full((80, 160), 100, dtype=np.int8)
    data[35:45, 2:158] = 0  # a corridor, 0.5 m wide, along x = 0 ... 8
    data[35:60, 100:120] = 0  # with a bay at x = 5 ... 6
    path = np.column_stack([np.linspace(2.0, 7.5, 111), np.full(111, 2.0)])
    pose = Pose2D(4.0, 2.0, 0.0)
    peer = outline(pose, Pose2D(3.0, 2.0, 0.0), BURGER.radius)
    np.testing.assert_allclose(np.hypot(*(peer - (-1.0, 0.0)).T), BURGER.radius)

    def waiting_cell():
        blocked = OccupancyGrid(data.copy(), 0.05, (0.0, 0.0))
        rows, cols = blocked.cells(pose.transform(peer)).T
        blocked.data[rows, cols] = 100
        field = travel_field(make_costmap(blocked, CostmapParams(0.155, 0.6, 4.0)), pose[:2])
        return find_waiting_cell(field, path, BURGER.radius)

    x, y = OccupancyGrid(data, 0.05, (0.0, 0.0)).centers(np.array(waiting_cell()))
    assert 5.0 < x < 6.0
    assert y > 2.0 + 2 * BURGER.radius + 0.1
    assert not is_beside((x, y), path, 2 * BURGER.radius + 0.1)
    data[35:60, 100:120] = 100
    data[35:45, 100:120] = 0
    assert waiting_cell() is None


def test_beside_a_path_counts_as_far_as_one_surveys_ahead():
    path = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]])
    assert is_beside((2.0, 0.2), path, 0.3)
    assert not is_beside((2.0, 0.2), path, 0.3, reach=1.5)
    assert not is_beside((2.0, 0.4), path, 0.3)

import math

import numpy as np
import pytest

from lidarnaut.envs.geometry import UNKNOWN, OccupancyGrid, Pose2D, wrap_angle


@pytest.mark.parametrize(
    ("theta", "expected"), [(0.0, 0.0), (math.pi, -math.pi), (-math.pi, -math.pi), (7.0, 7.0 - 2 * math.pi)]
)
def test_angles_are_wrapped_to_the_half_open_turn(theta, expected):
    assert wrap_angle(theta) == pytest.approx(expected, abs=1e-12)


def test_composition_equals_multiplying_matrices():
    def matrix(pose):
        c, s = math.cos(pose.theta), math.sin(pose.theta)
        return np.array([[c, -s, pose.x], [s, c, pose.y], [0, 0, 1]])

    rng = np.random.default_rng(0)
    for _ in range(50):
        a, b = (Pose2D(*rng.uniform(-4, 4, 3)) for _ in range(2))
        np.testing.assert_allclose(matrix(a.compose(b)), matrix(a) @ matrix(b), atol=1e-12)
        np.testing.assert_allclose(matrix(a.inverse()), np.linalg.inv(matrix(a)), atol=1e-12)
        np.testing.assert_allclose(matrix(a.between(b)), np.linalg.inv(matrix(a)) @ matrix(b), atol=1e-12)
        points = rng.uniform(-4, 4, (5, 2))
        expected = (matrix(a) @ np.column_stack([points, np.ones(5)]).T)[:2].T
        np.testing.assert_allclose(a.transform(points), expected, atol=1e-12)


def test_a_point_lies_in_the_cell_whose_centre_is_nearest_also_outside():
    grid = OccupancyGrid(np.full((3, 4), UNKNOWN, dtype=np.int8), resolution=0.5, origin=(-1.0, 2.0))
    assert grid.bounds == (-1.0, 2.0, 1.0, 3.5)
    cells = np.stack(np.meshgrid(np.arange(3), np.arange(4), indexing="ij"), axis=-1)
    centers = grid.centers(cells)
    np.testing.assert_allclose(centers[2, 0], (-0.75, 3.25))
    offsets = np.random.default_rng(0).uniform(-0.24, 0.24, centers.shape)
    np.testing.assert_array_equal(grid.cells(centers + offsets), cells)
    around = grid.cells(np.array([[-1.01, 2.1], [1.01, 2.1], [0.0, 1.99], [0.0, 3.51], [0.0, 2.1]]))
    np.testing.assert_array_equal(around[0], (0, -1))
    np.testing.assert_array_equal(grid.contains(around), [False, False, False, False, True])


@pytest.mark.parametrize(
    ("data", "resolution", "culprit"),
    [
        (np.zeros((2, 2)), 0.05, "float64"),
        (np.zeros(4, dtype=np.int8), 0.05, "1D"),
        (np.zeros((2, 2), dtype=np.int8), 0.0, "resolution"),
    ],
)
def test_nonsense_is_refused(data, resolution, culprit):
    with pytest.raises(ValueError, match=culprit):
        OccupancyGrid(data, resolution, (0.0, 0.0))

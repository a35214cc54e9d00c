import math

import numpy as np
import pytest

from envs.geometry.clearance import clearance
from envs.geometry.polyline import lengths_along, points_at, resample

CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.5]])


def test_lengths_and_points_along():
    along = lengths_along(CORNERS)
    assert along.tolist() == [0.0, 1.0, 1.5]
    assert lengths_along(CORNERS[:1]).tolist() == [0.0]
    assert points_at(CORNERS, along, 1.25).tolist() == [1.0, 0.25]
    assert points_at(CORNERS, along, np.array([-1.0, 0.5, 9.0])).tolist() == [[0.0, 0.0], [0.5, 0.0], [1.0, 0.5]]


def test_resampled_points_are_equally_far_apart_and_keep_the_ends():
    points = resample(CORNERS, 0.1)
    np.testing.assert_allclose(np.hypot(*np.diff(points, axis=0).T), 0.1)
    np.testing.assert_allclose(points[10], (1.0, 0.0), atol=1e-12)
    assert (points[[0, -1]] == CORNERS[[0, -1]]).all()
    assert np.hypot(*np.diff(resample(CORNERS, 0.07), axis=0).T).max() <= 0.07 + 1e-12
    assert len(resample(CORNERS, 10.0)) == 2
    assert len(resample(CORNERS[:1], 0.1)) == 1


@pytest.mark.parametrize(
    ("point", "expected"),
    [((0, 2), 1), ((1, 0), 1), ((0, 0), math.sqrt(2)), ((-3, 0), 0.5), ((-2, 0.1), -0.4), ((1, 2), 0)],
)
def test_clearance_is_the_distance_to_the_nearest_segment_or_circle(point, expected):
    segments, circles = np.array([[1.0, 1.0, 1.0, 3.0]]), np.array([[-2.0, 0.0, 0.5]])
    assert clearance(*point, segments, circles) == pytest.approx(expected)
    assert clearance(0.0, 0.0, np.empty((0, 4)), np.empty((0, 3))) == math.inf

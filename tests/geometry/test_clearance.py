import math

import numpy as np
import pytest

from envs.geometry.clearance import clearance


@pytest.mark.parametrize(
    ("point", "expected"),
    [((0, 2), 1), ((1, 0), 1), ((0, 0), math.sqrt(2)), ((-3, 0), 0.5), ((-2, 0.1), -0.4), ((1, 2), 0)],
)
def test_clearance_is_the_distance_to_the_nearest_segment_or_circle(point, expected):
    segments, circles = np.array([[1.0, 1.0, 1.0, 3.0]]), np.array([[-2.0, 0.0, 0.5]])
    assert clearance(*point, segments, circles) == pytest.approx(expected)


def test_clearance_without_obstacles_is_infinite():
    assert clearance(0.0, 0.0, np.empty((0, 4)), np.empty((0, 3))) == math.inf

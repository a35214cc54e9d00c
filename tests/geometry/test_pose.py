import math

import numpy as np
import pytest

from envs.geometry import Pose2D, wrap_angle


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

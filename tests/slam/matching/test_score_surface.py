import math

import numpy as np
import pytest

from lidarnaut.envs.slam.matching.fields import build_pyramid
from lidarnaut.envs.slam.matching.score_surface import (
    TEMPERATURE,
    TURN_STEP,
    match_covariance,
    second_moments,
    surface_scores,
)

from ..rooms import FLAT, rectangle, render_field, visible_points


def pyramid_of(walls, poses, range_max=10.0):
    return build_pyramid(render_field(walls, poses, 240, range_max), 3, 1.0)


def test_moments_of_a_quadratic_surface_are_its_covariance():
    covariance = np.array([[0.09, 0.03, 0.0], [0.03, 0.04, 0.0], [0.0, 0.0, 0.0004]])
    turns, steps = np.arange(-6, 7) * TURN_STEP, np.arange(-25, 26) * 0.05
    offsets = np.meshgrid(turns, steps, steps, indexing="ij")
    d = np.stack(offsets[::-1], axis=-1)
    scores = 0.8 - 0.5 * TEMPERATURE * np.einsum("...i,ij,...j", d, np.linalg.inv(covariance), d)
    found = second_moments(scores, 0.05)
    np.testing.assert_allclose(found, covariance, rtol=0.02, atol=1e-6)


def test_scores_equal_the_slow_reference():
    pyramid = pyramid_of(FLAT, [(2.0, 1.5, 0.2), (3.0, 2.5, 1.0)])
    pose = (5.5, 2.0, 0.7)  # half of the points leave the field
    points = visible_points(FLAT, (2.0, 1.5, 0.2), 240, 10.0)
    scores = surface_scores(pyramid, points, pose, 0.6)
    assert scores.shape == (5, 13, 13)
    margin = 200  # maximum distance of points outside of the field
    field = np.pad(pyramid.levels[0].astype(int), margin)
    for turn in (-1, 0, 1):
        c, s = math.cos(pose[2] + turn * 0.02), math.sin(pose[2] + turn * 0.02)
        u, v = points[::4].astype(float).T
        for i in (-6, 0, 5):
            for j in (-6, -1, 6):
                x, y = pose[0] + 0.1 * j + c * u - s * v, pose[1] + 0.1 * i + s * u + c * v
                q = np.floor((x - pyramid.x) / 0.05 - 0.5 + 1e-9).astype(int)
                r = np.floor((y - pyramid.y) / 0.05 - 0.5 + 1e-9).astype(int)
                around = [field[margin + r + k, margin + q + m] for k in (0, 1) for m in (0, 1)]
                expected = np.max(around, axis=0).sum() / (100 * len(u))
                assert scores[turn + 2, i + 6, j + 6] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("angle", [0.0, math.pi / 6])
def test_a_corridor_gives_an_ellipse_along_it(angle):
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    corridor = (rectangle(-20.0, -1.0, 20.0, 1.0).reshape(-1, 2) @ turn.T).reshape(-1, 4)
    poses = [(*(turn @ (0.5 * k, 0.0)), angle) for k in range(-6, 7)]
    pyramid = pyramid_of(corridor, poses, range_max=3.5)
    pose = (0.0, 0.0, angle)
    points = visible_points(corridor, pose, 240, 3.5)
    covariance = match_covariance(pyramid, points, pose, 1.0)
    values, vectors = np.linalg.eigh(covariance[:2, :2])
    assert math.sqrt(values[0]) < 0.06
    assert math.sqrt(values[1]) > 0.4
    assert abs(vectors[:, 1] @ turn[:, 0]) > math.cos(0.05)


def test_without_points_nothing_is_known():
    pyramid = pyramid_of(FLAT, [(2.0, 1.5, 0.2)])
    covariance = match_covariance(pyramid, np.zeros((0, 2), np.float32), (2.0, 1.5, 0.2), 1.0)
    assert covariance[0, 0] > 5.0**2
    assert covariance[1, 1] > 5.0**2

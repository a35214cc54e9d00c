import math

import numpy as np
import pytest

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.simulation.contact import is_cut

NO_CIRCLES = np.empty((0, 3))


def is_cut_slowly(pose, before, body, wall):
    """Sample many points of the wall, and of the motion from the previous pose."""
    (_, _, half_length, half_width), center = body, np.array([body[:2]])
    share = np.linspace(0.0, 1.0, 2001)[:, None]
    points = pose.inverse().transform(wall[:2] + share * (wall[2:] - wall[:2])) - center
    if half_width == 0.0:
        inside = np.hypot(*points.T) < half_length
    else:
        inside = (np.abs(points) < (half_length, half_width)).all(axis=1)
    [here], [there] = pose.transform(center), before.transform(center)
    along, ahead = wall[2:] - wall[:2], there - here
    t, u = np.linalg.solve(np.column_stack([along, -ahead]), here - wall[:2])
    return bool(inside.any()) or (0.0 <= t <= 1.0 and 0.0 <= u <= 1.0)


@pytest.mark.parametrize("half_width", [0.2, 0.0])
def test_walls_in_a_body_or_across_its_way_are_found(half_width):
    rng, found = np.random.default_rng(4), 0
    body = (0.1, -0.05, 0.3, half_width)
    for _ in range(400):
        pose, before = (Pose2D(*rng.uniform([-0.5, -0.5, -math.pi], [0.5, 0.5, math.pi])) for _ in range(2))
        start = rng.uniform(-0.6, 0.6, 2)
        wall = np.concatenate([start, start + rng.uniform(-0.6, 0.6, 2)])
        expected = is_cut_slowly(pose, before, body, wall)
        assert is_cut(tuple(pose), tuple(before), body, wall[None], NO_CIRCLES) == expected
        found += expected
    assert 80 < found < 320


@pytest.mark.parametrize("half_width", [0.2, 0.0])
def test_circles_are_found_as_their_outlines_are(half_width):
    rng, found = np.random.default_rng(5), 0
    body, angles = (0.1, -0.05, 0.3, half_width), np.linspace(0.0, 2.0 * math.pi, 1001)
    for _ in range(400):
        pose, before = (tuple(rng.uniform([-0.5, -0.5, -math.pi], [0.5, 0.5, math.pi])) for _ in range(2))
        x, y, radius = rng.uniform([-1.0, -1.0, 0.05], [1.0, 1.0, 0.3])
        points = np.column_stack([x + radius * np.cos(angles), y + radius * np.sin(angles)])
        outline = np.hstack([points[:-1], points[1:]])
        is_round_it = is_cut(pose, before, body, outline, NO_CIRCLES)
        is_in_it = math.dist(pose[:2], (x, y)) < radius - 0.15  # body and motion may touch no outline
        is_found = is_cut(pose, before, body, np.empty((0, 4)), np.array([[x, y, radius]]))
        assert is_found == is_round_it or (is_found and is_in_it)
        found += is_found
    assert 80 < found < 320


@pytest.mark.parametrize("theta", [0.0, 0.5 * math.pi])
def test_walls_parallel_to_a_side_are_found_inside_alone(theta):
    for y, expected in ((0.19, True), (0.21, False), (-0.19, True), (-0.21, False)):
        c, s = math.cos(theta), math.sin(theta)
        wall = np.array([[-5.0 * c - y * s, -5.0 * s + y * c, 5.0 * c - y * s, 5.0 * s + y * c]])
        pose = (0.0, 0.0, theta)
        assert is_cut(pose, pose, (0.0, 0.0, 0.3, 0.2), wall, NO_CIRCLES) == expected

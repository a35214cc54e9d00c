import math

import numpy as np
import pytest

from lidarnaut.envs.geometry.raycast import Beams, cast_rays
from lidarnaut.envs.worlds import load_world

TURN = 2 * math.pi


def all_pairs(x, y, heading, beams, segments, circles, num_beams):
    angles = heading + beams.angle_min + beams.angle_increment * np.arange(num_beams)
    d = np.column_stack([np.cos(angles), np.sin(angles)])
    with np.errstate(all="ignore"):
        a, e = segments[:, :2] - (x, y), segments[:, 2:] - segments[:, :2]
        scale = d[:, :1] * e[:, 1] - d[:, 1:] * e[:, 0]
        t = (a[:, 0] * e[:, 1] - a[:, 1] * e[:, 0]) / scale
        u = (a[:, 0] * d[:, 1:] - a[:, 1] * d[:, :1]) / scale
        hits = np.where((t >= 0) & (u >= 0) & (u <= 1), t, np.inf).min(axis=1, initial=np.inf)
        c = circles[:, :2] - (x, y)
        along = d @ c.T
        root = np.sqrt(along**2 - (c**2).sum(axis=1) + circles[:, 2] ** 2)
        near = np.where(along - root >= 0, along - root, along + root)
        hits = np.minimum(hits, np.where(near >= 0, near, np.inf).min(axis=1, initial=np.inf))
    return np.where(hits <= beams.range_max, hits, np.inf)


def cast(segments, *, angles=(0.0, math.pi / 2, 4)):
    """Cast rays from the origin; `angles`: first angle, increment, number of beams."""
    angle_min, increment, num_beams = angles
    out = np.empty(num_beams, dtype=np.float32)
    cast_rays(0.0, 0.0, 0.0, Beams(angle_min, increment, 10.0), np.array(segments, float), np.empty((0, 3)), out)
    return out


@pytest.mark.parametrize(("fov", "num_beams"), [(TURN, 360), (4.71, 720), (1.0, 33)])
@pytest.mark.parametrize("name", ["turtlebot3_world", "aws_small_house", "aws_bookstore", "thicket"])
def test_equals_testing_all_pairs(name, fov, num_beams):
    rng = np.random.default_rng(7)
    if name == "thicket":
        middles = rng.uniform(-6, 6, (1216, 2))
        segments = np.hstack([middles, middles + rng.normal(0, 0.5, middles.shape)])
        circles = np.column_stack([rng.uniform(-6, 6, (40, 2)), rng.uniform(0.02, 0.6, 40)])
        bounds = (-6, -6, 6, 6)
    else:
        world = load_world(name)
        segments, circles, bounds = world.segments, world.circles, world.bounds
    beams = Beams(-fov / 2, fov / (num_beams if fov == TURN else num_beams - 1), 8.0)
    out = np.empty(num_beams, dtype=np.float32)
    for _ in range(92_160 // (18 * num_beams) + 1):
        arguments = (*rng.uniform(bounds[:2], bounds[2:]), rng.uniform(-9, 9), beams, segments, circles)
        cast_rays(*arguments, out)
        np.testing.assert_allclose(out, all_pairs(*arguments, num_beams), rtol=0, atol=1e-6)


def test_a_sensor_on_a_wall_sees_it_at_no_distance():
    out = cast([[-1, 0, 1, 0]], angles=(0.1, TURN / 7, 7))
    np.testing.assert_array_equal(out, 0.0)
    np.testing.assert_allclose(cast([[-1, 1e-5, 1, 1e-5]]), [np.inf, 1e-5, np.inf, np.inf])


def test_segments_without_length_and_beams_along_a_segment_hit_nothing():
    assert np.isinf(cast([[1, 0, 1, 0], [0, 0, 0, 0]])).all()
    assert np.isinf(cast([[1, 0, 2, 0]])[1:]).all()

"""The lidar's ray casting against PyBullet's, in every world of the library."""

import math

import numpy as np
import pytest

from envs.geometry.raycast import Beams, cast_rays
from envs.worlds import WORLD_NAMES, load_world

BEAMS, POSES, REACH = 360, 25, 12.0
TOLERANCE = 0.002
GRAZED = 1e-3
"""How near a beam may pass a corner and be called grazing [m]: PyBullet's rays see triangles a little too large."""


@pytest.fixture(scope="module")
def bullet():
    pytest.importorskip("pybullet", reason="PyBullet is not installed")
    from envs.simulation.bullet_world import BulletClient

    bullet = BulletClient()
    yield bullet
    bullet.close()


def cast_in_bullet(bullet, x, y, z, angles):
    starts = np.tile([x, y, z], (len(angles), 1))
    ends = starts + REACH * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))])
    hits = bullet.rayTestBatch(starts.tolist(), ends.tolist())
    return np.array([fraction * REACH if body >= 0 else np.inf for body, _, fraction, *_ in hits])


@pytest.mark.parametrize("name", WORLD_NAMES)
def test_ranges_agree_within_two_millimetres(bullet, name):
    from envs.simulation.bullet_world import build_meshes, outlines

    world = load_world(name)
    bullet.resetSimulation()
    (mesh,) = build_meshes(bullet, outlines(world, sagitta=1e-5), world.height)
    bullet.createMultiBody(0.0, mesh)
    corners = np.vstack([world.segments[:, :2], world.segments[:, 2:]])
    rng = np.random.default_rng(0)
    ranges, grazing = np.empty(BEAMS), 0
    for _ in range(POSES):
        x, y = rng.uniform(world.bounds[:2], world.bounds[2:])
        heading = rng.uniform(-math.pi, math.pi)
        increment = 2 * math.pi / BEAMS
        cast_rays(x, y, heading, Beams(0.0, increment, REACH), world.segments, world.circles, ranges)
        angles = heading + increment * np.arange(BEAMS)
        theirs = cast_in_bullet(bullet, x, y, 0.5 * world.height, angles)
        with np.errstate(invalid="ignore"):
            differ = ~((ranges == theirs) | (np.abs(ranges - theirs) <= TOLERANCE))
        for beam in np.flatnonzero(differ):
            nearer = min(ranges[beam], theirs[beam])
            point = np.array([x + nearer * math.cos(angles[beam]), y + nearer * math.sin(angles[beam])])
            assert np.hypot(*(corners - point).T).min() < GRAZED, f"{ranges[beam]} m against {theirs[beam]} m"
            grazing += 1
    assert grazing <= 0.001 * BEAMS * POSES

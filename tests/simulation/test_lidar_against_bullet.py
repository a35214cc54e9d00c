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

    return BulletClient()


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
        heading, increment = rng.uniform(-math.pi, math.pi), 2 * math.pi / BEAMS
        cast_rays(x, y, heading, Beams(0.0, increment, REACH), world.segments, world.circles, ranges)
        angles = heading + increment * np.arange(BEAMS)
        directions = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(BEAMS)])
        starts = np.tile([x, y, 0.5 * world.height], (BEAMS, 1))
        hits = bullet.rayTestBatch(starts.tolist(), (starts + REACH * directions).tolist())
        theirs = np.array([fraction * REACH if body >= 0 else np.inf for body, _, fraction, *_ in hits])
        for beam in np.flatnonzero(~np.isclose(ranges, theirs, rtol=0.0, atol=TOLERANCE)):
            point = np.array([x, y]) + min(ranges[beam], theirs[beam]) * directions[beam, :2]
            assert np.hypot(*(corners - point).T).min() < GRAZED, f"{ranges[beam]} m against {theirs[beam]} m"
            grazing += 1
    assert grazing <= 0.001 * BEAMS * POSES

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from lidarnaut.envs.geometry import OccupancyGrid, Pose2D
from lidarnaut.envs.localization import PRESETS, Amcl
from lidarnaut.envs.localization.likelihood_field import LikelihoodField
from lidarnaut.envs.localization.rivals import count_crossed
from lidarnaut.envs.robots import LidarParams
from lidarnaut.envs.simulation import Reading
from lidarnaut.envs.worlds import World, rasterize
from tests.slam.rooms import rectangle, scan

LIDAR = LidarParams(180, 6.0)
PARAMS = replace(PRESETS["default"], global_particles=20_000)
KNOWN = np.diag([0.05**2, 0.05**2, 0.05**2])
NO_CIRCLES = np.empty((0, 3))


def walls_of(*corners, x=0.0, y=0.0):
    points = np.array(corners, dtype=float) + (x + 0.025, y + 0.025)
    return np.hstack([points, np.roll(points, -1, axis=0)])


def box(*bounds):
    return rectangle(*bounds) + 0.025


def started(pose, walls, seed=0, params=PARAMS):
    amcl = Amcl(LIDAR, params)
    amcl.reset(np.random.default_rng(seed), pose, map_of(walls), KNOWN)
    return amcl


def map_of(walls):
    low, high = walls.reshape(-1, 2).min(axis=0), walls.reshape(-1, 2).max(axis=0)
    bounds = (*(low - 0.025), *(high + 0.025))
    return rasterize(World("rooms", walls, NO_CIRCLES, (Pose2D(1.0, 1.0, 0.0),), bounds), 0.05)


def drive(amcl, walls, poses, before=None):
    """Drive through poses with exact odometry; yield belief and true pose after each."""
    for pose in poses:
        motion = Pose2D(0.0, 0.0, 0.0) if before is None else before.between(pose)
        before = pose
        yield amcl.update(Reading.of_scan(scan(pose, walls=walls, lidar=LIDAR, circles=NO_CIRCLES)), motion), pose


def straight(*points, step=0.1):
    """Return poses along straight lines, `step` [m] apart, with turns on the spot."""
    poses, heading = [], None
    for (x0, y0), (x1, y1) in itertools.pairwise(points):
        goal = math.atan2(y1 - y0, x1 - x0)
        for turn in np.linspace(0.0, 1.0, 8) if heading is not None else [1.0]:
            start = goal if heading is None else heading
            poses.append(Pose2D(x0, y0, start + turn * ((goal - start + math.pi) % math.tau - math.pi)))
        count = round(math.dist((x0, y0), (x1, y1)) / step)
        poses += [Pose2D(x0 + (x1 - x0) * k / count, y0 + (y1 - y0) * k / count, goal) for k in range(1, count + 1)]
        heading = goal
    return poses


def off(belief, pose):
    return math.dist(belief.pose[:2], pose[:2])


ROOM = np.vstack([box(0, 0, 4, 3), box(0.5, 2, 1.2, 2.6), box(3, 0.4, 3.4, 0.8)])
AISLE = walls_of((0, 0), (30, 0), (30, 2), (0, 2))
ALIKE = {
    "four rooms": (np.vstack([ROOM + (x, 0, x, 0) for x in (0, 5, 10, 15)]), (1.0, 1.0), (2.5, 1.0), (2.5, 2.0)),
    "rectangle": (box(0, 0, 5, 3), (1.0, 1.0), (4.0, 1.0), (4.0, 2.0), (2.0, 2.0)),
    "square": (box(0, 0, 4, 4), (1.0, 1.0), (3.0, 1.0), (3.0, 2.5)),
    "corridor": (AISLE, (12.0, 1.0), (17.0, 1.0)),
}


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", ALIKE)
def test_what_looks_alike_stays_lost(name, seed):
    walls, *points = ALIKE[name]
    for belief, pose in drive(started(None, walls, seed), walls, straight(*points)):  # noqa: B007
        assert belief.is_lost
    if name in ("four rooms", "rectangle", "square"):
        hypotheses = belief.hypotheses
        assert 2 <= len(hypotheses) <= {"four rooms": 4, "rectangle": 2, "square": 4}[name]
        assert tuple(hypotheses[0, :3]) == belief.pose
        assert hypotheses[:, 3].sum() == pytest.approx(1.0)
        assert (hypotheses[:, 3] > 0.05).all()
        assert min(math.dist(row[:2], pose[:2]) for row in hypotheses) < 0.1 or name == "four rooms"


@pytest.mark.parametrize("preset", ["nav2", "default"])
def test_a_known_start_among_look_alikes_is_tracked(preset):
    walls, *points = ALIKE["four rooms"]
    amcl = started(Pose2D(*points[0], 0.0), walls, params=PRESETS[preset])
    for belief, pose in drive(amcl, walls, straight(*points)):
        assert not belief.is_lost
        assert off(belief, pose) < 0.4
        assert belief.hypotheses.tolist() == [[*belief.pose, 1.0]]


def test_a_kidnapped_robot_among_look_alikes_is_lost():
    walls = np.vstack([ROOM, ROOM + (5, 0, 5, 0)])
    amcl = started(Pose2D(1.0, 1.0, 0.0), walls)
    list(drive(amcl, walls, straight((1.0, 1.0), (2.5, 1.0))))
    there = straight((7.0, 2.5), (6.0, 1.5), (8.5, 1.5), (7.5, 2.0), (6.5, 1.0), (7.5, 1.0))
    lost = [belief.is_lost for belief, _ in drive(amcl, walls, there)]
    assert all(lost[25:])


def test_mirrored_rooms_are_told_apart():
    mirrored = (9.05, 0.0, 9.05, 0.0) + ROOM * (-1, 1, -1, 1)
    walls = np.vstack([ROOM, mirrored])
    *_, (belief, pose) = drive(started(None, walls), walls, straight((1.0, 1.0), (2.5, 1.0), (2.5, 2.0)))
    assert not belief.is_lost
    assert off(belief, pose) < 0.1


@pytest.mark.parametrize("has_chest", [True, False])
def test_a_piece_of_furniture_that_comes_into_view_decides(has_chest):
    """Two rooms with a corner; only one has a chest behind the corner. A missing chest is evidence, too."""
    corner = ((0, 0), (5, 0), (5, 2), (2, 2), (2, 6), (0, 6))
    walls = np.vstack([walls_of(*corner), walls_of(*corner, x=6), box(1.3, 4.8, 1.9, 5.4)])
    x = 0.0 if has_chest else 6.0
    before = straight((x + 4.5, 1.0), (x + 2.6, 1.0), (x + 4.5, 1.0), (x + 2.6, 1.0))
    after = straight((x + 2.6, 1.0), (x + 0.8, 1.0), (x + 0.8, 4.0))
    amcl = started(None, walls)
    assert all(belief.is_lost for belief, _ in drive(amcl, walls, before))
    assert len(amcl.belief.hypotheses) == 2
    for belief, pose in drive(amcl, walls, after, before[-1]):
        assert belief.is_lost or off(belief, pose) < 0.2
    assert not belief.is_lost
    assert len(belief.hypotheses) == 1


def test_hypotheses_follow_odometry_between_scans_that_are_used():
    walls, *points = ALIKE["rectangle"]
    amcl = started(None, walls, params=replace(PARAMS, lost_updates=5))
    list(drive(amcl, walls, straight(*points)))
    before = amcl.belief.hypotheses
    assert len(before) == 2
    motion = Pose2D(0.03, 0.01, 0.02)
    after = amcl.update(Reading.of_scan(np.full(180, np.nan, dtype=np.float32)), motion).hypotheses
    np.testing.assert_allclose(after[:, :3], [Pose2D(*row[:3]).compose(motion) for row in before], atol=1e-6)


def test_crossed_beams_by_hand():
    data = np.zeros((20, 60), dtype=np.int8)
    data[5:15, 30:34] = 100
    grid = OccupancyGrid(data, 0.1, (0.0, 0.0))
    field = LikelihoodField(PARAMS, LIDAR, grid)
    # Behind the obstacle, through it, up to it, into it by less than the margin, and along its side.
    hits = np.array([[20.0, 0.0], [35.0, 0.0], [19.5, 0.0], [21.0, 0.0], [40.0, 5.2]], dtype=np.float32).T.copy()
    lidars = np.array([[0.0, 0.0]] * 4 + [[0.0, 5.2]], dtype=np.float32).T.copy()

    def crossed(k, pose):
        return count_crossed(field.table, hits[:, [k]].copy(), lidars[:, [k]].copy(), 2.0, np.float32(pose))

    assert [crossed(k, (1.05, 1.05, 0.0)) for k in range(5)] == [0, 1, 0, 0, 0]
    assert crossed(0, (1.05, 0.25, 0.0)) == 0
    assert crossed(1, (1.05, 1.05, math.pi / 2)) == 0
    assert crossed(1, (3.2, -1.0, math.pi / 2)) == 1

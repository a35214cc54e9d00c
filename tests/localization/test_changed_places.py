"""Tracking where the world is not as on the map: the pose is right, though few beams agree with the map."""

import math

import numpy as np
import pytest

from lidarnaut.benchmarks.drives.localization import add_cupboards, load_known_world
from lidarnaut.envs.geometry import OccupancyGrid, Pose2D
from lidarnaut.envs.localization.likelihood_field import LikelihoodField
from lidarnaut.envs.localization.rivals import Rivals, share_crossed
from lidarnaut.envs.robots import LidarParams
from lidarnaut.envs.simulation import Reading
from tests.localization.test_amcl import CIRCLES, LIDAR, PARAMS, SEGMENTS, START, circle, distance, started
from tests.slam.rooms import rectangle, scan


def room(x0=0.0, door=None):
    """Return the walls of the mapped room, with the left wall at `x0` and a gap in it between `door` (y0, y1)."""
    corners = [(x0, 0), (7, 0), (7, 3), (4, 3), (4, 5), (x0, 5)]
    walls = [(*a, *b) for a, b in zip(corners, corners[1:] + corners[:1])]
    if door is not None:
        walls = [*walls[:-1], (x0, 5, x0, door[1]), (x0, door[0], x0, 0)]
    return np.array(walls, dtype=float) + 0.025


def with_boxes(*boxes):
    return np.vstack([SEGMENTS, *(rectangle(*one) for one in boxes)])


TWO = (0.1, 2.4, 0.6, 3.9), (2.6, 0.1, 4.2, 0.6)
SIX = (*TWO, (4.6, 1.6, 5.4, 2.9), (0.7, 2.5, 1.5, 3.0), (2.2, 2.2, 3.2, 2.7), (0.1, 0.1, 0.6, 0.7))
PEOPLE = np.array([[0.5, 0.6], [2.4, 1.2], [2.3, 2.0], [1.2, 2.6], [0.5, 2.2]])
BEYOND = [(-3.0, 0.5, 0.0, 0.5), (-3.0, 0.5, -3.0, 3.5), (-3.0, 3.5, 0.0, 3.5)]
CHANGED = {
    "two cupboards": (with_boxes(*TWO), CIRCLES),
    "six cupboards": (with_boxes(*SIX), CIRCLES),
    "people": (SEGMENTS, np.vstack([CIRCLES, np.column_stack([PEOPLE, np.full(5, 0.2)])])),
    "closed door": (np.vstack([SEGMENTS, [(2.4, 0.0, 2.4, 3.2)]]), CIRCLES),
    "wall moved outwards": (room(-0.6), CIRCLES),
    "wall moved inwards": (room(0.5), CIRCLES),
    "door to a room that is not on the map": (np.vstack([room(door=(0.6, 3.4)), BEYOND]), CIRCLES),
}


def drive(amcl, walls, circles, steps=60, start=START, keep=slice(None)):
    """Drive a circle; return position errors [m] and lost flags."""
    rows = []
    for pose, motion in circle(steps, start):
        ranges = scan(pose, walls=walls, lidar=LIDAR, circles=circles)
        seen = np.full_like(ranges, np.inf)
        seen[keep] = ranges[keep]
        belief = amcl.update(Reading.of_scan(seen), motion)
        rows.append((distance(amcl, pose), belief.is_lost))
    return np.array(rows).T


@pytest.mark.parametrize("name", CHANGED)
def test_a_right_pose_is_kept_in_a_changed_place(name):
    errors, lost = drive(started(1), *CHANGED[name])
    assert errors.max() < 0.1
    assert lost.mean() <= 0.05


def test_a_right_pose_is_kept_with_few_returns():
    errors, lost = drive(started(1), *CHANGED["six cupboards"], keep=slice(0, None, 5))
    assert errors.max() < 0.1
    assert lost.mean() <= 0.05


def test_a_pose_that_is_given_slightly_wrong_is_corrected_in_a_changed_place():
    given = Pose2D(START.x + 0.3, START.y - 0.2, START.theta + 0.15)
    amcl = started(1, given, covariance=None)
    errors, lost = drive(amcl, *CHANGED["two cupboards"])
    assert errors[-20:].max() < 0.1
    assert lost.mean() <= 0.1


def test_a_kidnapped_robot_is_found_in_a_changed_place():
    amcl, (walls, circles) = started(1), CHANGED["two cupboards"]
    drive(amcl, walls, circles)
    errors, lost = drive(amcl, walls, circles, start=Pose2D(5.2, 0.8, 0.3))
    assert lost[:15].any()
    assert errors[-5:].max() < 0.2
    assert np.count_nonzero((errors > 0.5) & (lost == 0.0)) < 10


def test_a_pose_given_in_another_part_of_the_room_is_reported_at_once():
    amcl = started(1, Pose2D(5.2, 0.8, 2.0))
    walls, circles = CHANGED["two cupboards"]
    errors, lost = drive(amcl, walls, circles, steps=40)
    assert lost[:10].all()
    assert errors[-1] < 0.2


def test_a_search_that_finds_nothing_better_is_seldom_repeated(monkeypatch):
    searches, update = [], Rivals.update
    monkeypatch.setattr(Rivals, "update", lambda self, *args: searches.append(1) or update(self, *args))
    drive(started(1), *CHANGED["six cupboards"], steps=80)
    assert 1 <= len(searches) <= 3


def test_the_share_of_beams_through_obstacles_by_hand():
    data = np.zeros((40, 60), dtype=np.int8)
    data[:, 30] = 100
    lidar = LidarParams(4, 6.0, fov=math.tau)
    field = LikelihoodField(PARAMS, lidar, OccupancyGrid(data, 0.1, (0.0, 0.0)))
    ahead = int(np.argmax(lidar.directions[0]))
    for ranges, share in (([1.0] * 4, 0.0), ([2.0] * 4, 0.25), ([1.1] * 4, 0.0), ([np.inf] * 4, 0.0)):
        beams = np.array(ranges, dtype=np.float32)
        pose = Pose2D(2.05, 2.05, -math.atan2(lidar.directions[1, ahead], lidar.directions[0, ahead]))
        assert share_crossed(field, beams, pose) == share


def test_cupboards_stand_near_the_start_and_leave_most_of_the_floor():
    setup = load_known_world("turtlebot3_world")
    start = setup.world.spawns[0]
    changed = add_cupboards(setup, start, 2, np.random.default_rng(3))
    added = changed.world.segments[len(setup.world.segments) :].reshape(2, 4, 2, 2)
    distances = np.hypot(*(added.mean(axis=(1, 2)) - start[:2]).T)
    assert ((distances >= 1.5) & (distances <= 4.0)).all()
    assert changed.area.traversable.sum() >= 0.8 * setup.area.traversable.sum()
    assert add_cupboards(setup, start, 0, np.random.default_rng(3)) is setup

import math

import numpy as np
import pytest

from lidarnaut.benchmarks.drives.slams import kidnap
from lidarnaut.envs.geometry import OccupancyGrid, Pose2D
from lidarnaut.envs.slam import HectorParams, make_slam
from lidarnaut.envs.slam.log_odds_map import LogOddsMap
from lidarnaut.envs.slam.relocalization import LOST_SCANS, LocalizationMonitor, Relocalizer
from tests.slam.rooms import BOX, LIDAR, ROOM, STAY, follow, scan, see

MOTION = Pose2D(0.15, 0.0, -0.25)


@pytest.fixture(scope="module")
def grid():
    slam = make_slam("hector", LIDAR, 0.05)
    for pose, belief in follow(slam, [MOTION] * 30):
        assert math.dist(belief.pose[:2], pose[:2]) < 0.03
    return slam.belief.grid


@pytest.mark.parametrize("start", [Pose2D(-1.0, -1.0, 1.0), Pose2D(2.0, -1.0, -2.8), Pose2D(0.2, 2.0, 0.7)])
def test_the_pose_is_found_wherever_the_robot_was_put(grid, start):
    relocalizer, pose, by_odometry = Relocalizer(LIDAR), start, STAY
    for _ in range(30):
        found = relocalizer.update(scan(pose), by_odometry, grid)
        if found is not None:
            break
        pose, by_odometry = pose.compose(Pose2D(0.05, 0.0, 0.1)), by_odometry.compose(Pose2D(0.05, 0.0, 0.1))
    assert math.dist(found[:2], pose[:2]) < 0.06
    assert math.cos(found.theta - pose.theta) > math.cos(0.03)


def test_another_room_is_not_taken_for_this_one(grid):
    relocalizer = Relocalizer(LIDAR)
    for k in range(40):
        walls = [(0.4 * x0, 1.3 * y0, 0.4 * x1, 1.3 * y1) for x0, y0, x1, y1 in ROOM]
        ranges = scan(Pose2D(0.02 * k, 0.0, 0.0), walls=walls)
        assert relocalizer.update(ranges, Pose2D(0.02 * k, 0.0, 0.0), grid) is None


def test_a_pose_is_found_on_a_map_that_lacks_a_part_of_the_room(grid):
    data = grid.data.copy()
    _, col = grid.cells(np.array([0.9, 0.0]))
    data[:, col:] = -1
    partial_map, start = OccupancyGrid(data, grid.resolution, grid.origin), Pose2D(-1.6, 1.2, 2.0)
    relocalizer, pose, by_odometry = Relocalizer(LIDAR), start, STAY
    for _ in range(30):
        found = relocalizer.update(scan(pose), by_odometry, partial_map)
        if found is not None:
            break
        pose, by_odometry = pose.compose(Pose2D(0.05, 0.0, 0.1)), by_odometry.compose(Pose2D(0.05, 0.0, 0.1))
    assert math.dist(found[:2], pose[:2]) < 0.06
    assert math.cos(found.theta - pose.theta) > math.cos(0.03)


@pytest.mark.parametrize(
    ("results", "is_found"),
    [
        ([0.25, 0.25, 0.01, 0.25, 0.25], True),
        ([0.25, 0.25, None, 0.25, 0.25], False),
        ([0.04] * 30, False),
    ],
)
def test_an_ambiguous_search_keeps_the_evidence_and_a_poor_one_does_not(grid, monkeypatch, results, is_found):
    answers = iter(results)

    def search(self, grid):
        lead = next(answers, None)
        return (None, 0.0) if lead is None else (Pose2D(9.0, 0.0, 0.0), lead)

    monkeypatch.setattr(Relocalizer, "search", search)
    relocalizer = Relocalizer(LIDAR)
    found = [relocalizer.update(NOTHING, STAY, grid) for _ in range(300)]
    assert any(pose is not None for pose in found) == is_found


@pytest.mark.parametrize(("shift", "jump", "is_lost"), [(0.9, 0.5, True), (0.9, 0.3, False), (0.0, 0.5, False)])
def test_a_match_far_from_odometry_with_beams_through_walls_does_not_fit(grid, shift, jump, is_lost):
    monitor, pose = LocalizationMonitor(LIDAR), Pose2D(-1.0, -1.0, 1.0)
    matched = Pose2D(pose.x, pose.y + shift, pose.theta)
    for _ in range(LOST_SCANS):
        monitor.update(scan(pose), Pose2D(matched.x + jump, matched.y, matched.theta), matched, True, grid)
    assert monitor.is_lost == is_lost


NOTHING = np.full(LIDAR.num_beams, np.nan, dtype=np.float32)


def test_a_scan_that_fits_ends_the_doubt_but_not_a_loss(grid):
    tracker, seen = LocalizationMonitor(LIDAR), []
    for fits in (None, False, True, False, None, False, False, True, None):
        instead = tracker.update(NOTHING, MOTION, MOTION, fits, grid)
        seen.append((instead, tracker.has_mismatch, tracker.is_lost))
    free, doubt, lost = (None, False, False), (MOTION, True, False), (MOTION, True, True)
    assert seen == [free, doubt, free, doubt, (None, True, False), doubt, lost, lost, lost]


CORNER = Pose2D(2.6, -1.6, 0.0)
BLIND, THERE, ELSEWHERE = (NOTHING, STAY), (scan(CORNER), STAY), (scan(STAY), CORNER)
"""Scans and poses: no return, and beams through walls, from a corner and at it."""


@pytest.mark.parametrize(
    ("flags", "steps", "fits", "lost"),
    [
        # Without odometry, one scan that fits ends a loss.
        ({"has_odometry": False}, [BLIND] * 7, (False, False, None, False, None, True, False), "...XX.."),
        # A robot that sees through walls is lost, however well hits fit.
        ({}, [ELSEWHERE] * 2 + [THERE] + [ELSEWHERE] * 6, [True] * 9, ".....XXXX"),
        # Among people, such beams are no loss, and scans that fit end one.
        ({"meets_people": True}, [ELSEWHERE] * 14, [True] * 6 + [False] * 3 + [True] * 5, "........XXXX.."),
    ],
)
def test_whether_a_robot_is_lost_by_fits_and_beams(grid, flags, steps, fits, lost):
    tracker, found = LocalizationMonitor(LIDAR, flags.get("has_odometry", True)), ""
    tracker.meets_people = flags.get("meets_people", False)
    for (ranges, pose), fit in zip(steps, fits):
        tracker.update(ranges, pose, pose, fit, grid)
        found += "X" if tracker.is_lost else "."
    assert found == lost


def test_a_pose_is_taken_only_where_no_other_one_is_like_it():
    steps, found = [Pose2D(0.1 * k - 0.5, 0.1 * (k % 3), 0.5 * k) for k in range(14)], []
    for width in (1.0, 1.3):  # width of a second room at 12 m, relative to the first room
        map = LogOddsMap(HectorParams(map_width=40.0, map_height=20.0), LIDAR)
        for pose in steps:
            map.integrate(scan(pose), pose)
            walls = [(width * x0, y0, width * x1, y1) for x0, y0, x1, y1 in ROOM + BOX]
            map.integrate(scan(pose, walls=walls), pose._replace(x=pose.x + 12.0))
        relocalizer = Relocalizer(LIDAR)
        found.append([relocalizer.update(scan(pose), steps[0].between(pose), map.grid) for pose in steps])
    assert found[0] == [None] * len(steps)
    best = next(k for k, pose in enumerate(found[1]) if pose)
    assert math.dist(found[1][best][:2], steps[best][:2]) < 0.1


@pytest.mark.parametrize("name", ["hector", "graph", "gmapping"])
def test_a_robot_is_lost_only_once_it_is_kidnapped_and_then_found_on_a_map_that_was_left_alone(name):
    slam, rng = make_slam(name, LIDAR, 0.05), np.random.default_rng(3)
    assert not any(belief.is_lost for _, belief in follow(slam, [MOTION] * 80, rng))
    before, pose, lost = slam.belief.grid.data.copy(), Pose2D(2.0, -1.0, -2.8), 0
    for _ in range(60):
        belief = slam.update(see(pose, rng), MOTION)
        if lost and not belief.is_lost:
            break
        lost += belief.is_lost
        np.testing.assert_array_equal(belief.grid.data, before)
        pose = pose.compose(MOTION)
    assert 0 < lost < 40
    assert math.dist(belief.pose[:2], pose[:2]) < 0.1
    for _ in range(60):
        pose = pose.compose(MOTION)
        assert not slam.update(see(pose, rng), MOTION).is_lost
    assert math.dist(slam.belief.pose[:2], pose[:2]) < 0.05
    assert (slam.belief.grid.data != before).any()
    if name != "hector":  # Hector has no path
        slam.finish()
        assert math.dist(slam.belief.path[-1, :2], pose[:2]) < 0.3


def test_the_pose_graph_has_a_loop_closure_and_no_odometry_across_a_relocalization():
    slam = make_slam("graph", LIDAR, 0.05)
    slam.reset(np.random.default_rng(0))
    pose = STAY
    for k in range(200):
        if k == 60:
            pose, before = Pose2D(2.0, -1.0, -2.8), len(slam.nodes)
        slam.update(see(pose), MOTION if k else STAY)
        pose = pose.compose(MOTION)
    constraints = slam.graph.arrays.constraints
    is_across = (constraints.node >= before) & (slam.nodes.spans.rows[constraints.submap, 0] < before)
    assert constraints.is_loop[is_across].all()
    assert constraints.is_loop[constraints.node == before].sum() == 1
    assert len(slam.nodes) > before + 20
    np.testing.assert_array_equal(slam.nodes.home.rows[:before] < slam.nodes.home.rows[before], True)


@pytest.mark.parametrize("slam", ["tinyslam", "graph"])
def test_a_kidnapped_robot_says_so_and_finds_itself(slam):
    lost_after, found_after, is_wrong = kidnap(slam, "turtlebot3_house", 0, 8.0, 60.0)
    assert lost_after < 10.0
    assert found_after < 50.0
    assert not is_wrong

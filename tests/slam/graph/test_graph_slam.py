import dataclasses
import itertools
import math

import numpy as np
import pytest

from lidarnaut.envs.geometry import UNKNOWN, Pose2D
from lidarnaut.envs.robots import LidarParams, OdometryNoise
from lidarnaut.envs.simulation import Reading
from lidarnaut.envs.slam import GraphSlam, GraphSlamParams, load_params
from lidarnaut.envs.slam.graph.local_slam import LocalSlam
from lidarnaut.envs.slam.graph.nodes import MapRendering, NodeStore

from ..rooms import rectangle, scan

BOXES = [(5.0, 0.3, 5.8, 0.9), (10.5, 4.0, 11.4, 4.5), (2.0, 8.0, 2.6, 8.6), (7.4, 8.2, 7.8, 8.7)]
HALL = np.concatenate([rectangle(*box) for box in [(0.0, 0.0, 12.0, 9.0), (3.0, 3.0, 9.0, 6.0), *BOXES]])
"""Corridor around a block, with boxes on its outer wall, shape (24, 4) [m]."""
LIDAR = LidarParams(num_beams=120, range_max=6.0)
STAY = Pose2D(0.0, 0.0, 0.0)
NOTHING = np.full(120, np.inf, dtype=np.float32)
NOISE = OdometryNoise(position_std=0.005, position_per_metre=0.03, heading_std=0.005, heading_per_metre=0.03)
SIZES = {"loop_scans": 4, "submap_spacing": 10, "cells_per_scan": 120_000}
UNMATCHED = {"residual_variance": 1e9, "uses_distributions": False, "retry_below": 0.0}
BLIND = GraphSlamParams(odometry_noise=NOISE, **SIZES, **UNMATCHED)
"""Parameters with poses from odometry, corrected only by loop closures."""


def laps(count, step=0.25):
    corners = np.array([(1.5, 1.6), (10.0, 1.6), (10.0, 7.4), (1.5, 7.4)])
    poses = []
    for k in range(4 * count):
        start, end = corners[k % 4], corners[(k + 1) % 4]
        heading, far = math.atan2(*(end - start)[::-1]), np.hypot(*(end - start))
        poses += [Pose2D(*(start + (end - start) * s / far), heading) for s in np.arange(0.0, far - 0.3, step)]
        poses += [Pose2D(*end, heading + turn) for turn in (0.4, 0.8, 1.2)]
    return poses


@pytest.fixture(scope="module")
def drive():
    poses, rng = laps(2), np.random.default_rng(0)
    ranges = [scan(pose, rng, walls=HALL, lidar=LIDAR) for pose in poses]
    motions = [STAY]
    for before, after in itertools.pairwise(poses):
        x, y, theta = before.between(after)
        motions.append(Pose2D(1.01 * x, y + 0.01 * x, theta + 0.004 * np.hypot(x, y) + 0.002 * rng.standard_normal()))
    return np.array([poses[0].between(pose) for pose in poses]), ranges, motions


def run(drive, params=BLIND, watch=lambda slam: None):
    slam = GraphSlam(LIDAR, params)
    online = []
    for seen, motion in zip(*drive[1:]):
        online.append(slam.update(Reading.of_scan(seen), motion).pose)
        watch(slam)
    return slam, np.array(online)


def test_loop_closures_correct_the_drift_of_odometry(drive):
    truth = drive[0]
    slam, online = run(drive)
    drifted, corrected = (np.hypot(*(poses - truth)[:, :2].T) for poses in (slam.nodes.poses, online))
    assert drifted.max() > 1.0
    assert corrected[-1] < 0.3
    assert slam.loop_closures > 20
    again, poses = run(drive)
    assert poses.tobytes() == online.tobytes()
    assert again.belief.grid.data.tobytes() == slam.belief.grid.data.tobytes()
    slam.finish()
    again.finish()
    assert np.hypot(*(slam.belief.path - truth)[:, :2].T).max() < 0.3
    assert again.belief.path.tobytes() == slam.belief.path.tobytes()


def test_a_corrected_map_replaces_the_live_one_when_it_is_complete(drive):
    seen = []

    def watch(slam):
        belief, update = slam.belief, slam.belief.update
        seen.append((belief.grid.data, update.redrawn, slam._rendering is not None))
        if not update.redrawn:
            assert update.correction is None
            return
        nodes = slam.graph.arrays.nodes
        np.testing.assert_array_equal(belief.path, nodes)
        np.testing.assert_array_equal(belief.path, update.correction.after)
        assert update.correction.before.shape == nodes.shape
        assert math.dist(belief.pose[:2], nodes[-1, :2]) < 0.05
        assert slam.last_key_pose == belief.pose
        expected = MapRendering(slam.params, LIDAR).map
        for node, pose in enumerate(nodes.tolist()):
            expected.integrate(slam.nodes.ranges[node], Pose2D(*pose))
        np.testing.assert_array_equal(belief.grid.data, expected.grid.data)
        assert belief.grid.origin == expected.grid.origin == update.origin
        np.testing.assert_array_equal(update.new_cells, np.argwhere(belief.grid.data != UNKNOWN))

    slam = GraphSlam(LIDAR, BLIND)
    grid = slam.belief.grid
    slam, _ = run(drive, watch=watch)
    assert sum(redrawn for _, redrawn, _ in seen) >= 2
    assert grid is not slam.belief.grid
    kept = slam.belief.grid
    slam.finish()
    assert slam.belief.grid is kept is slam.map.grid
    first = next(k for k, (_, redrawn, _) in enumerate(seen) if redrawn)
    # During the rendering of about 80 nodes, 120,000 cells at each scan, the live map is updated.
    assert [is_rendering for _, _, is_rendering in seen[first - 4 : first + 1]] == [True] * 4 + [False]
    assert seen[first][0] is not seen[first - 1][0]


def test_a_match_with_the_map_corrects_odometry_before_any_loop(drive):
    truth, _, motions = drive
    slam, online = run(drive, load_params("default", slam="graph"))
    odometry = list(itertools.accumulate(motions, Pose2D.compose))
    assert np.hypot(*(np.array(odometry) - truth)[:, :2].T).max() > 1.0
    assert np.hypot(*(online - truth)[:, :2].T).max() < 0.15
    assert 0.0 < slam.belief.covariance[0, 0] < 0.05**2
    assert not slam.belief.is_lost


def test_the_pose_graph_names_submaps_and_nodes(drive):
    slam, _ = run(drive)
    slam.update(Reading.of_scan(NOTHING), Pose2D(0.05, 0.01, 0.1))
    node, relative = slam.anchor
    assert node == len(slam.nodes) - 1
    np.testing.assert_allclose(relative, (0.05, 0.01, 0.1), atol=1e-9)
    graph = slam.pose_graph
    constraints = slam.graph.arrays.constraints
    assert len(graph.nodes) == slam.graph.num_submaps + len(slam.nodes)
    assert len(graph.edges) == constraints.is_active.sum()
    assert graph.loops.shape == (slam.loop_closures, 2, 2)
    assert graph.loops[-1, 1].tolist() in slam.graph.arrays.nodes[:, :2].tolist()
    assert constraints.is_active.all()
    k = int(np.abs(constraints.information[:, 0, 1]).argmax())
    first, second, motion, information = graph.edges[k]
    found = Pose2D(*graph.nodes[first]).between(Pose2D(*graph.nodes[second]))
    np.testing.assert_allclose(found, motion, atol=0.2)
    # Information in the node's frame: rotated into the submap's frame, it is equal to the graph's information.
    turn = np.array(Pose2D(0.0, 0.0, motion[2]).transform(np.eye(2))).T
    np.testing.assert_allclose(turn @ information[:2, :2] @ turn.T, constraints.information[k, :2, :2], rtol=1e-9)


def test_covariance_of_a_node_grows_with_odometry_and_shrinks_with_the_match():
    params = dataclasses.replace(BLIND, residual_variance=0.5, submap_spacing=20)

    def covariance(scan):
        nodes = NodeStore(LIDAR)
        local = LocalSlam(params, LIDAR, nodes)
        for k in range(11):
            assert local.match(scan, Pose2D(0.3, 0.0, 0.0) if k else STAY) is not False
            local.add_node(scan)
        return local.constraint_covariance(0)

    free = covariance(NOTHING)
    sigma_xy, sigma_theta = 0.005 + 0.03 * 0.3, 0.005 + 0.03 * 0.3
    assert free[2, 2] == pytest.approx(5 * 10 * sigma_theta**2 + 0.008**2)
    assert free[0, 0] == pytest.approx(5 * 10 * sigma_xy**2 + 0.03**2)
    # Heading errors before the robot drives on: sum of squared levers 0.3 m to 2.7 m.
    levers = sum((0.3 * k) ** 2 for k in range(1, 10))
    assert free[1, 1] == pytest.approx(5 * (10 * sigma_xy**2 + levers * sigma_theta**2) + 0.03**2)

    sides = np.array([(-50.0, -1.0, 50.0, -1.0), (-50.0, 1.0, 50.0, 1.0)])
    along = covariance(scan(STAY, walls=sides, lidar=LIDAR))
    assert along[0, 0] > 0.2 * free[0, 0]
    assert along[1, 1] < 0.1 * free[1, 1]
    assert along[2, 2] < 0.1 * free[2, 2]


def test_the_start_pose_is_that_of_the_first_node(drive):
    _, ranges, motions = drive
    start = Pose2D(3.0, -2.0, 1.0)
    slam, at_origin = GraphSlam(LIDAR, BLIND), GraphSlam(LIDAR, BLIND)
    slam.reset(np.random.default_rng(0), start)
    for seen, motion in zip(ranges[:30], motions[:30]):
        pose, other = (each.update(Reading.of_scan(seen), motion).pose for each in (slam, at_origin))
    np.testing.assert_allclose(pose, start.compose(other), atol=1e-6)
    np.testing.assert_allclose(slam.graph.arrays.nodes[0], start)

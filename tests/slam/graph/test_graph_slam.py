import itertools
import math

import numpy as np
import pytest

from envs.geometry import Pose2D
from envs.robots import LidarParams
from envs.slam.graph.graph_slam import GraphTracker
from envs.slam.graph.local_slam import LocalSlam, Match
from envs.slam.graph.nodes import NodeStore
from envs.slam.graph.params import GraphSlamParams, MotionNoise

from ..matching.rooms import cast, rectangle

HALL = np.concatenate(
    [
        rectangle(0.0, 0.0, 12.0, 9.0),
        rectangle(3.0, 3.0, 9.0, 6.0),
        rectangle(5.0, 0.3, 5.8, 0.9),
        rectangle(10.5, 4.0, 11.4, 4.5),
        rectangle(2.0, 8.0, 2.6, 8.6),
        rectangle(7.4, 8.2, 7.8, 8.7),
    ]
)
"""A corridor around a block, with boxes on its outer wall, shape (24, 4) [m]."""
LIDAR = LidarParams(num_beams=120, range_max=6.0)


def trust_odometry(fields, points, predicted, prior):
    """Match nothing."""
    return Match(predicted, np.zeros((3, 3)), 1.0)


def laps(count, step=0.25):
    """Return poses along laps around the block."""
    corners = np.array([(1.5, 1.6), (10.0, 1.6), (10.0, 7.4), (1.5, 7.4)])
    poses = []
    for k in range(4 * count):
        start, end = corners[k % 4], corners[(k + 1) % 4]
        heading, far = math.atan2(*(end - start)[::-1]), np.hypot(*(end - start))
        poses += [Pose2D(*(start + (end - start) * s / far), heading) for s in np.arange(0.0, far - 0.3, step)]
        # Turn on the spot.
        poses += [Pose2D(*end, heading + turn) for turn in (0.4, 0.8, 1.2)]
    return poses


@pytest.fixture(scope="module")
def drive():
    """Return true poses in the frame of the start, ranges and motions by odometry, for two laps."""
    poses, rng = laps(2), np.random.default_rng(0)
    angles = np.arctan2(LIDAR.directions[1], LIDAR.directions[0])
    ranges = [(cast(HALL, pose, angles, 6.0) + 0.01 * rng.standard_normal(120)).astype(np.float32) for pose in poses]
    motions = [Pose2D(0.0, 0.0, 0.0)]
    for before, after in itertools.pairwise(poses):
        x, y, theta = before.between(after)
        motions.append(Pose2D(1.01 * x, y + 0.01 * x, theta + 0.004 * np.hypot(x, y) + 0.002 * rng.standard_normal()))
    return np.array([poses[0].between(pose) for pose in poses]), ranges, motions


PARAMS = GraphSlamParams(
    loop_scans=4,
    submap_spacing=10,
    noise=MotionNoise(position=0.005, position_per_metre=0.03, heading=0.005, heading_per_metre=0.03),
)


def test_loop_closures_correct_the_drift_of_odometry(drive):
    truth, ranges, motions = drive

    def run():
        tracker = GraphTracker(LIDAR, PARAMS, trust_odometry)
        return tracker, np.array([tracker.update(scan, motion) for scan, motion in zip(ranges, motions)])

    tracker, online = run()
    tracker.finish()
    drifted, corrected, final = (
        np.hypot(*(poses - truth)[:, :2].T) for poses in (tracker.nodes.poses, online, tracker.graph.arrays.nodes)
    )
    assert drifted.max() > 1.0
    assert corrected[-1] < 0.2
    assert final.max() < 0.3
    loops = tracker.graph.arrays.constraints.is_loop
    assert loops.sum() > 20
    assert tracker.num_corrections > 2
    again, poses = run()
    np.testing.assert_array_equal(poses, online)
    again.finish()
    assert again.graph.arrays.nodes.tobytes() == tracker.graph.arrays.nodes.tobytes()


def test_covariance_of_a_node_grows_with_odometry_and_shrinks_with_the_match():
    points = np.ones((50, 2), dtype=np.float32)

    def covariance(curvature):
        nodes = NodeStore(0.0, 0.0)

        def matcher(fields, points, predicted, prior):
            return Match(predicted, np.array(curvature, dtype=float), 1.0)

        local = LocalSlam(PARAMS, matcher, nodes)
        for _ in range(11):
            local.update(points, Pose2D(0.3, 0.0, 0.0))
        assert len(nodes) == 11
        return local.covariance(0)

    free = covariance(np.zeros((3, 3)))
    sigma_xy, sigma_theta = PARAMS.noise.sigmas(0.3, 0.0)
    assert free[2, 2] == pytest.approx(5 * 10 * sigma_theta**2 + 0.008**2)
    assert free[0, 0] == pytest.approx(5 * 10 * sigma_xy**2 + 0.03**2)
    # Headings err before the robot drives on: sum of squared levers 0.3 m to 2.7 m.
    levers = sum((0.3 * k) ** 2 for k in range(1, 10))
    assert free[1, 1] == pytest.approx(5 * (10 * sigma_xy**2 + levers * sigma_theta**2) + 0.03**2)

    noise = 0.02 * 50 / 0.05**2  # curvature along x and y that noise alone shows
    along = covariance(np.diag([noise, noise + 1e6, 1e5]))
    assert along[0, 0] > 0.8 * free[0, 0]
    assert along[1, 1] == pytest.approx(0.03**2, rel=0.05)
    assert along[2, 2] < 0.02 * free[2, 2]


def test_scans_without_hits_follow_odometry():
    tracker = GraphTracker(LIDAR, PARAMS, trust_odometry)
    nothing = np.full(120, np.inf, dtype=np.float32)
    for _ in range(90):
        tracker.update(nothing, Pose2D(0.25, 0.0, 0.0))
    assert tracker.pose.x == pytest.approx(22.5)
    assert tracker.graph.num_nodes == 90
    assert not tracker.graph.arrays.constraints.is_loop.any()


@pytest.mark.parametrize("change", [{"resolution": 0.0}, {"submap_spacing": 0}, {"phi": math.nan}])
def test_params_that_make_no_sense_are_refused(change):
    with pytest.raises(ValueError, match=next(iter(change))):
        GraphSlamParams(**change)

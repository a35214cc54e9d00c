import math

import numpy as np
import pytest

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.robots import LidarParams, OdometryNoise
from lidarnaut.envs.simulation import Reading
from lidarnaut.envs.slam import HectorParams, make_slam
from lidarnaut.envs.slam.log_odds_map import LogOddsMap
from lidarnaut.envs.slam.matching.distributions import MAX_SQUARED_DISTANCE, MIN_POINTS, POINT_VARIANCE, SIDE, evaluate

from ..rooms import rectangle, scan

LIDAR = LidarParams(num_beams=360, range_max=8.0)
HALL = np.concatenate([rectangle(-2.0, -3.0, 42.0, 3.0), *(rectangle(x, 1.5, x + 0.6, 2.0) for x in range(1, 41, 4))])
WHEELS = OdometryNoise(position_std=0.002, heading_std=0.005, heading_per_metre=0.02)


def see_hall(pose, rng):
    """Return a scan [m], and its points in the base frame, shape (n, 2) [m]."""
    ranges = scan(pose, rng, walls=HALL, lidar=LIDAR)
    hit = ranges < LIDAR.range_max
    return ranges, (ranges[hit] * LIDAR.directions[:, hit]).T


def mapped(poses, size):
    """Return a map of scans in the hall, and the scan points in the map frame, shape (n, 2) [m]."""
    grid_map = LogOddsMap(HectorParams(map_width=size, map_height=size, skip_exceeding=True), LIDAR)
    rng, points = np.random.default_rng(1), []
    for pose in poses:
        ranges, seen = see_hall(pose, rng)
        grid_map.integrate(ranges, pose)
        points.append(pose.transform(seen))
    return grid_map, np.concatenate(points)


def squares(grid_map, points):
    """Return points by square, relative to its centre [cells], slowly."""
    cells = points / grid_map.grid.resolution - grid_map.corner
    found = {}
    for col, row in cells:
        at = int(row // SIDE), int(col // SIDE)
        found.setdefault(at, []).append((col - SIDE * (at[1] + 0.5), row - SIDE * (at[0] + 0.5)))
    return {at: np.array(rows) for at, rows in found.items()}


def test_squares_hold_the_sums_of_their_points_while_the_map_grows():
    grid_map, points = mapped([Pose2D(3.0 * k, 0.1 * k, 0.3 * k) for k in range(4)], 5.0)
    expected = np.zeros_like(grid_map.sums)
    assert expected.shape[1] > 5.0 / 0.05 / SIDE
    for at, rows in squares(grid_map, points).items():
        x, y = rows.T
        expected[at] = len(rows), x.sum(), y.sum(), (x * x).sum(), (x * y).sum(), (y * y).sum()
    np.testing.assert_allclose(grid_map.sums, expected, atol=0.02)


def test_evaluate_matches_the_slow_reference():
    grid_map, points = mapped([Pose2D(0.3 * k, 0.0, 0.1) for k in range(5)], 40.0)
    seen = (see_hall(Pose2D(1.02, -0.03, 0.11), np.random.default_rng(2))[1].T / 0.05).astype(np.float32)
    x, y = grid_map.to_cells(1.0, 0.0)
    fit = evaluate(grid_map.sums, seen, seen.shape[1], x, y, 0.1, 0.25)
    stored, h, b, matched = squares(grid_map, points), np.zeros((3, 3)), np.zeros(3), 0
    for point in seen.T.astype(float):
        turned = np.array([[math.cos(0.1), -math.sin(0.1)], [math.sin(0.1), math.cos(0.1)]]) @ point
        col, row = turned + (x, y)
        at = int(row // SIDE), int(col // SIDE)
        if len(rows := stored.get(at, ())) < MIN_POINTS:
            continue
        covariance = np.cov(rows.T, bias=True) + POINT_VARIANCE * np.eye(2)
        precision = np.linalg.inv(covariance) - np.eye(2) / np.linalg.eigvalsh(covariance)[1]
        apart = np.array([col - SIDE * (at[1] + 0.5), row - SIDE * (at[0] + 0.5)]) - rows.mean(axis=0)
        if (squared := apart @ precision @ apart) >= MAX_SQUARED_DISTANCE:
            continue
        jacobian = np.array([[1.0, 0.0, -turned[1]], [0.0, 1.0, turned[0]]])
        weight = 0.25 * (1.0 - squared / MAX_SQUARED_DISTANCE) ** 2
        h += weight * jacobian.T @ precision @ jacobian
        b -= weight * jacobian.T @ precision @ apart
        matched += 1
    np.testing.assert_allclose(fit[:6], [h[0, 0], h[0, 1], h[0, 2], h[1, 1], h[1, 2], h[2, 2]], rtol=0.02)
    np.testing.assert_allclose(fit[6:9], b, rtol=0.02, atol=0.02 * np.abs(b).max())
    assert 100 < matched == fit.total


def end_of_drive(slam, seed):
    """Drive 38 m through the hall; return the position error at the end [m]."""
    rng, start = np.random.default_rng(seed), Pose2D(0.0, 0.0, 0.2)
    tracked = make_slam(slam, LIDAR, odometry_noise=WHEELS)
    tracked.update(Reading.of_scan(see_hall(start, rng)[0]), Pose2D(0.0, 0.0, 0.0))
    pose = start
    for _ in range(190):
        moved = Pose2D(pose.x + 0.2, 0.0, 0.2 * math.cos(0.1 * pose.x))
        motion = pose.between(moved).compose(Pose2D(0.0, 0.0, 0.003 * rng.standard_normal()))
        pose = moved
        tracked.update(Reading.of_scan(see_hall(pose, rng)[0]), motion)
    return math.dist(start.compose(tracked.belief.pose)[:2], pose[:2])


@pytest.mark.parametrize("slam", ["hector", "graph"])
def test_poses_drift_less_than_with_cells_alone(slam):
    fine, coarse = ([end_of_drive(name, k) for k in range(3)] for name in (slam, f"{slam}?uses_distributions=false"))
    assert np.mean(fine) < 0.5 * np.mean(coarse)

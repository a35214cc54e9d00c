"""Beams that contradict the other scans of a log."""

import math
from dataclasses import replace

import numpy as np
import pytest

from envs.logs.consistency import conflict_share
from envs.logs.log import Log
from envs.robots import LidarParams, Mount

LIDAR = LidarParams(num_beams=4, range_max=8.0, fov=1.5 * math.pi, mount=Mount(0.12, 0.0, yaw=0.75 * math.pi))
"""Beams ahead, to the left, back and to the right, from 0.12 m ahead of the base."""


def log_of(ranges):
    num_scans = len(ranges)
    scans = np.array(ranges, dtype=np.float32)
    return Log(np.arange(num_scans) * 1.0, np.zeros((num_scans, 3)), np.arange(num_scans), scans, LIDAR)


def test_beams_through_walls_are_counted():
    log = log_of([[2.0, 2.0, 2.0, 2.0]] * 10 + [[4.0, 4.0, 2.2, np.inf]])
    still = np.zeros((11, 3))
    assert conflict_share(log, still) == 2 / 43
    turned = still.copy()
    turned[:10, 2] = math.pi / 4  # the wall that the last scan passes through is beside its beams
    assert conflict_share(log, turned) == 0.0


def test_a_room_seen_twice_at_different_poses_conflicts():
    log = log_of([[2.0, 2.0, 2.0, 2.0]] * 10)
    poses = np.zeros((10, 3))
    assert conflict_share(log, poses) == 0.0
    poses[5:, 0] = 1.0
    assert conflict_share(log, poses) == 0.25  # ahead from the second half, back from the first
    for value in (np.nan, 1e12):
        poses[3, 1] = value
        assert math.isnan(conflict_share(log, poses))
    # Without a return there is nothing to tell.
    assert math.isnan(conflict_share(log_of([[np.inf] * 4, [np.nan] * 4]), np.zeros((2, 3))))


def test_thinned_logs_keep_scans_that_are_far_apart_or_turned():
    x = np.array([0.0, 0.3, 0.6, 1.1, 1.2, 1.2, 1.2])
    theta = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.3, 0.7])
    log = replace(log_of([[1.0 + k] * 4 for k in range(7)]), odometry=np.stack([x, 0 * x, theta], axis=1))
    thinned = log.thinned(1.0, 0.5)
    np.testing.assert_array_equal(thinned.scan_rows, [0, 3, 6])
    np.testing.assert_array_equal(thinned.ranges[:, 0], [1.0, 4.0, 7.0])
    assert len(thinned.times) == 7  # odometry stays as it is
    assert log.step_length == pytest.approx(0.3)
    assert thinned.step_length == pytest.approx(0.6)

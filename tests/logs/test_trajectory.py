import logging
import math

import numpy as np
import pytest

from lidarnaut.envs.logs import save_trajectory
from lidarnaut.envs.logs.trajectory import SCALE_T, odometry_scales, scale_std


@pytest.mark.parametrize(
    ("times", "kept"),
    [
        ([0.0, 1.0, 1.0, 2.0], [0.0, 1.0, 2.0]),
        ([0.0, 1.0, 0.5, 1.5, 2.0], [0.0, 1.0, 1.5, 2.0]),
        ([0.0, 1.0, 0.5, 0.9, 2.0], [0.0, 0.5, 0.9, 2.0]),
        ([5.0, 5.0, 5.0], [5.0]),
        ([1.7e9, 1.7e9 + 2e-7, 1.7e9 + 2e-6], [1.7e9, 1.7e9 + 2e-6]),  # equal as written
        ([0.0, 1e9, 1.0, 2.0, 3.0], [0.0, 1.0, 2.0, 3.0]),  # one clock error loses one pose
        ([5.0, 6.0, 0.0, 7.0, 8.0], [5.0, 6.0, 7.0, 8.0]),
        ([0.0, math.nan, 1.0, math.inf], [0.0, 1.0]),
        ([3.0], [3.0]),
        ([], []),
    ],
)
def test_times_of_a_written_trajectory_ascend_strictly(tmp_path, caplog, times, kept):
    caplog.set_level(logging.WARNING)
    poses = np.pad(np.zeros((len(times), 3)), ((0, 3), (0, 0)))
    poses[len(times) :] = [[math.nan, 0.0, 0.0], [0.0, math.inf, 0.0], [0.0, 0.0, math.nan]]
    times = [*times, *(3e9 + np.arange(3))]
    left_out = save_trajectory(tmp_path / "a.tum", np.array(times), poses)
    lines = [line for line in (tmp_path / "a.tum").read_text().splitlines() if not line.startswith("#")]
    assert [line.split()[0] for line in lines] == [f"{time:.6f}" for time in kept]
    assert left_out == len(times) - len(kept)
    assert (f"{left_out} of {len(times)} poses are left out" in caplog.text) is (left_out > 0)


def drive_with_slam(rng, scale=0.97, steps=3000):
    """Poses by odometry and by a SLAM of a drive of 38 m with stops and turns on the spot.

    The SLAM follows odometry up to the next key scan, and then has an error of 1 cm, correlated over 3 m of the path.
    """
    is_turning, way = np.arange(steps) % 50 >= 35, np.where(np.arange(steps) // 50 % 2, 0.1, -0.1)
    length = np.where(is_turning, 0.0, 0.03 * rng.uniform(0.2, 1.0, steps))
    heading = np.concatenate([[0.0], np.cumsum(is_turning * way)])
    measured = length / scale + 0.003 * np.sqrt(length) * rng.standard_normal(steps)
    forward = np.stack([np.cos(heading[:-1]), np.sin(heading[:-1])], axis=1)
    truth, odometry = (
        np.pad(np.cumsum(each[:, None] * forward, axis=0), ((1, 0), (0, 0))) for each in (length, measured)
    )
    poses, key, error, since = odometry.copy(), 0, np.zeros(2), np.zeros(2)
    for k in range(1, steps + 1):
        since += length[k - 1], abs(heading[k] - heading[k - 1])
        poses[k] = poses[key] + odometry[k] - odometry[key]
        if since[0] > 0.2 or since[1] > 0.6:
            kept = math.exp(-since[0] / 3.0)
            error = kept * error + 0.01 * math.sqrt(1.0 - kept**2) * rng.standard_normal(2)
            poses[k], key, since = truth[k] + error, k, np.zeros(2)
    return tuple(np.column_stack([each, heading]) for each in (odometry, poses))


def test_intervals_of_the_scale_hold_the_true_factor_in_most_drives():
    rng = np.random.default_rng(0)
    drives = [drive_with_slam(rng) for _ in range(100)]
    errors = np.array([odometry_scales(*drive)[0] - 0.97 for drive in drives])
    margins = SCALE_T * np.array([scale_std(*drive) for drive in drives])
    assert np.mean(np.abs(errors) <= margins) >= 0.9
    assert abs(np.mean(errors)) < 1e-3  # steps alone: 4e-3, drawn to 1 by the motions between key scans
    assert np.median(margins) < 4e-3
    odometry = np.pad(0.1 * np.arange(1000.0)[:, None], ((0, 0), (0, 2)))
    assert scale_std(odometry, odometry) == pytest.approx(0.0, abs=1e-9)
    assert math.isnan(scale_std(odometry[:370], odometry[:370]))  # 37 m
    assert math.isnan(scale_std(np.zeros((99, 3)), np.zeros((99, 3))))

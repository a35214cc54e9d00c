import logging
import math

import numpy as np
import pytest

from lidarnaut.envs.logs import load_log, save_trajectory
from lidarnaut.envs.logs.replay import Options, main
from lidarnaut.envs.logs.trajectory import NUM_PARTS, SCALE_T, odometry_scales, scale_std


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
    poses = np.zeros((len(times), 3))
    left_out = save_trajectory(tmp_path / "a.tum", np.array(times), poses)
    lines = [line for line in (tmp_path / "a.tum").read_text().splitlines() if not line.startswith("#")]
    assert [line.split()[0] for line in lines] == [f"{time:.6f}" for time in kept]
    assert left_out == len(times) - len(kept)
    assert (f"{left_out} of {len(times)} poses are left out" in caplog.text) is (left_out > 0)


def test_poses_that_are_not_finite_are_left_out(tmp_path):
    poses = np.array(
        [[0.0, 0.0, 0.0], [math.nan, 0.0, 0.0], [0.0, math.inf, 0.0], [1.0, 0.0, math.nan], [2.0, 0.0, 0.0]]
    )
    assert save_trajectory(tmp_path / "a.tum", np.arange(5.0), poses) == 3
    np.testing.assert_array_equal(np.loadtxt(tmp_path / "a.tum")[:, :2], [[0.0, 0.0], [4.0, 2.0]])


def test_trajectories_of_carmen_logs_ascend(tmp_path, caplog):
    """Times repeat in ODOM and FLASER lines, and run back by less than a second."""
    lines, stamps = [], [0.0, 0.1, 0.1, 0.05, 0.2, 0.3, 0.25, 0.4]
    for k, time in enumerate(stamps):
        pose = f"{0.1 * k:.3f} 0.0 0.0"
        lines.append(f"ODOM {pose} 0 0 0 {time} host {time}")
        lines.append(f"FLASER 3 1.0 2.0 3.0 {pose} {pose} {time} host {time}")
    (tmp_path / "a.log").write_text("\n".join(lines) + "\n")
    main(Options(tmp_path / "a.log", slam="odometry", field_of_view=1.0, out=tmp_path / "out"))
    times = np.loadtxt(tmp_path / "out" / "trajectory_0.tum")[:, 0]
    assert (np.diff(times) > 0.0).all()
    count = len(load_log(tmp_path / "a.log", field_of_view=1.0).times)
    assert f"trajectory_0.tum: {count - len(times)} of {count} poses are left out" in caplog.text
    assert len(times) == 5


def test_the_uncertainty_of_a_scale_follows_from_its_changes_along_the_path():
    rng, steps = np.random.default_rng(0), 200 * NUM_PARTS
    odometry = np.stack([0.1 * np.arange(steps + 1), np.zeros(steps + 1), np.zeros(steps + 1)], axis=1)
    found = []
    for _ in range(300):
        factors = np.repeat(0.97 + 0.02 * rng.standard_normal(NUM_PARTS), steps // NUM_PARTS)
        poses = np.zeros_like(odometry)
        poses[1:, 0] = 0.1 * np.cumsum(factors)
        found.append((odometry_scales(odometry, poses)[0], scale_std(odometry, poses)))
    scales, stds = np.array(found).T
    assert np.mean(scales) == pytest.approx(0.97, abs=0.001)
    assert np.std(scales) == pytest.approx(0.02 / math.sqrt(NUM_PARTS), rel=0.15)
    assert np.sqrt(np.mean(stds**2)) == pytest.approx(np.std(scales), rel=0.15)
    assert scale_std(odometry, odometry) == pytest.approx(0.0, abs=1e-9)
    assert math.isnan(scale_std(odometry[:370], odometry[:370]))  # 37 m
    assert math.isnan(scale_std(np.zeros((99, 3)), np.zeros((99, 3))))


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

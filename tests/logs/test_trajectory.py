import logging
import math

import numpy as np
import pytest

from lidarnaut.envs.logs import load_log, save_trajectory
from lidarnaut.envs.logs.replay import Options, main
from lidarnaut.envs.logs.trajectory import NUM_PARTS, odometry_scales, scale_std


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
    rng, steps = np.random.default_rng(0), 40 * NUM_PARTS
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
    assert np.mean(stds) == pytest.approx(np.std(scales), rel=0.15)
    assert scale_std(odometry, odometry) == pytest.approx(0.0, abs=1e-9)
    assert math.isnan(scale_std(odometry[:NUM_PARTS], odometry[:NUM_PARTS]))
    assert math.isnan(scale_std(np.zeros((99, 3)), np.zeros((99, 3))))

"""Trajectories: arrays of poses, shape (n, 3), x, y, heading [m, rad]."""

from pathlib import Path

import numpy as np

from lidarnaut.envs.geometry import wrap_angle

MAX_CLOCK_JUMP = 1.0
"""Clocks may run back by this much [s]: that of the Intel Research Lab's log does, by 0.9 s."""


def follow_odometry(odometry: np.ndarray, scan_rows: np.ndarray, scan_poses: np.ndarray) -> np.ndarray:
    """Fill the gaps between scans: from each scan's estimated pose on, move as odometry does until the next.

    Poses by odometry are of shape (n, 3), those estimated at the scans of shape (m, 3) [m, rad]; `scan_rows`, shape
    (m,), ascending, are the rows of odometry at which these were taken. Returns estimated poses, shape (n, 3); those
    before the first scan lead back from it.
    """
    scan = np.maximum(np.searchsorted(scan_rows, np.arange(len(odometry)), side="right") - 1, 0)
    return compose_poses(scan_poses[scan], between_poses(odometry[scan_rows[scan]], odometry))


def save_trajectory(path: Path, times: np.ndarray, poses: np.ndarray) -> None:
    """Write a trajectory, times [s] and poses, in the TUM format: time, position, orientation as a quaternion."""
    zero = np.zeros(len(times))
    x, y, theta = poses.T
    rows = np.stack([times, x, y, zero, zero, zero, np.sin(theta / 2), np.cos(theta / 2)], axis=1)
    np.savetxt(path, rows, fmt="%.6f", header="time x y z qx qy qz qw")


def compose_poses(parent: np.ndarray, child: np.ndarray) -> np.ndarray:
    """Return poses given in the frames of others, both of shape (n, 3), in the parent frame of those."""
    c, s = np.cos(parent[:, 2]), np.sin(parent[:, 2])
    x = parent[:, 0] + c * child[:, 0] - s * child[:, 1]
    y = parent[:, 1] + s * child[:, 0] + c * child[:, 1]
    return np.stack([x, y, wrap_angle(parent[:, 2] + child[:, 2])], axis=1)


def between_poses(parent: np.ndarray, child: np.ndarray) -> np.ndarray:
    """Return poses as seen from others in the same frame, both of shape (n, 3)."""
    c, s = np.cos(parent[:, 2]), np.sin(parent[:, 2])
    dx, dy = (child - parent)[:, :2].T
    return np.stack([c * dx + s * dy, -s * dx + c * dy, wrap_angle(child[:, 2] - parent[:, 2])], axis=1)


def pose_errors(poses: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return distances [m] and angles [rad] between poses, both of shape (n, 3): two arrays of shape (n,)."""
    return np.hypot(*(poses - truth)[:, :2].T), np.abs(wrap_angle(poses[:, 2] - truth[:, 2]))


def rms(values: np.ndarray) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def find_jump_back(times: np.ndarray) -> int | None:
    """Return the first row at which a clock, shape (n,) [s], n > 0, has run back by more than `MAX_CLOCK_JUMP`."""
    is_back = np.maximum.accumulate(times) - times > MAX_CLOCK_JUMP
    return int(is_back.argmax()) if is_back.any() else None

"""Trajectories: arrays of poses, shape (n, 3), x, y, heading [m, rad]."""

from pathlib import Path

import numpy as np

from lidarnaut.envs.geometry import wrap_angle

MAX_CLOCK_JUMP = 1.0
"""Clocks may run back by this much [s]: that of the Intel Research Lab's log does, by 0.9 s."""
MAX_SPEEDS = (5.0, 10.0)
"""Forward speed [m/s] and yaw rate [rad/s] that no robot of an unknown kind exceeds."""
CLOCK_JITTER = 0.02
"""Error of the time between two poses, beside that of stamps nearer to each other than usual [s]."""
MAX_GLITCH = 2.0
"""Longest excursion of the odometry that is bridged [s]."""


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


def bridge_glitches(
    times: np.ndarray, poses: np.ndarray, max_speeds: tuple[float, float] = MAX_SPEEDS
) -> tuple[np.ndarray, list[str]]:
    """Replace poses that a robot cannot have had by interpolation between the poses before and after.

    An excursion begins and ends with an impossible motion, lasts for at most `MAX_GLITCH`, and leads back within reach
    of the pose before it. An excursion at either end of the odometry gets the pose beside it. Other jumps stay.

    Args:
        times: shape (n,), ascending except for jitter [s].
        poses: shape (n, 3), x, y, heading [m, m, rad].
        max_speeds: forward speed [m/s] and yaw rate [rad/s].

    Returns:
        The poses, and a sentence on each kind of finding.
    """
    period = float(np.median(np.diff(times))) if len(times) > 1 else 0.0

    def is_possible(first: np.ndarray, last: np.ndarray) -> np.ndarray:
        duration = np.maximum(times[last] - times[first], period) + CLOCK_JITTER
        length, turn = pose_errors(poses[last], poses[first])
        result: np.ndarray = (length <= max_speeds[0] * duration) & (turn <= max_speeds[1] * duration)
        return result

    if not np.isfinite(times).all():
        return poses, []
    count, rows = len(times), np.arange(len(times))
    jumps = rows[:-1][~is_possible(rows[:-1], rows[1:])]
    fixed, bridged, stay, done = poses.copy(), list[int](), list[int](), -1
    for jump in jumps.tolist():
        if jump < done:
            continue
        ends = 1 + jumps[(jumps > jump) & (times[np.minimum(jumps + 1, count - 1)] - times[jump] <= MAX_GLITCH)]
        ends = ends[is_possible(np.full_like(ends, jump), ends)]
        before, after = jump, int(ends[0]) if len(ends) else count
        if not len(ends) and done < 0 and times[jump] - times[0] <= min(MAX_GLITCH, times[-1] - times[jump + 1]):
            before, after = -1, jump + 1
        elif not len(ends) and times[-1] - times[jump + 1] > MAX_GLITCH:
            stay.append(jump)
            continue
        first, last = before if before >= 0 else after, after if after < count else before
        duration = max(times[last] - times[first], 1e-9)
        share = np.clip((times[before + 1 : after] - times[first]) / duration, 0.0, 1.0)[:, None]
        start, motion = fixed[[first]], between_poses(fixed[[first]], poses[[last]])
        fixed[before + 1 : after] = compose_poses(np.repeat(start, len(share), axis=0), share * motion)
        bridged += [jump] * len(share)
        done = after
    said = []
    for found, fate in ((bridged, "poses are interpolated"), (stay, "jumps stay, do not trust a map beyond the first")):
        if found:
            k = found[0]
            length, turn = (each.item() for each in pose_errors(poses[[k + 1]], poses[[k]]))
            step = f"{length:.2f} m and {turn:.2f} rad in {times[k + 1] - times[k]:.3f} s at {times[k + 1]:.3f} s"
            limits = f"{max_speeds[0]:g} m/s or {max_speeds[1]:g} rad/s"
            said.append(f"odometry moves by {step}, beyond {limits}: {len(found)} {fate}")
    return fixed, said


def find_jump_back(times: np.ndarray) -> int | None:
    """Return the first row at which a clock, shape (n,) [s], n > 0, has run back by more than `MAX_CLOCK_JUMP`."""
    is_back = np.maximum.accumulate(times) - times > MAX_CLOCK_JUMP
    return int(is_back.argmax()) if is_back.any() else None

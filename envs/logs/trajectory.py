"""Trajectories: arrays of poses x, y, heading, shape (n, 3) [m, m, rad]."""

import logging
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from lidarnaut.envs.geometry import wrap_angle
from lidarnaut.envs.geometry.pose import between_poses

MAX_CLOCK_JUMP = 1.0
"""Maximum tolerated backward jump of the clock [s]; the Intel Research Lab log has 0.9 s."""
MAX_SPEEDS = (5.0, 10.0)
"""Default speed limits above which odometry counts as faulty: forward [m/s] and yaw rate [rad/s]."""
CLOCK_JITTER = 0.02
"""Maximum error of odometry time stamps in the check of speed limits [s]."""
BURST = 5
"""The odometry period is a mean over this number of poses before and after a motion, as poses may arrive in bursts."""
MAX_IMPOSSIBLE = 0.05
"""Maximum share of impossible odometry motions. Above this share, no motion is interpolated."""
MAX_GLITCH = 2.0
"""Maximum duration of an odometry glitch that is interpolated [s]."""
MAX_GAP, MAX_GAP_MOTION = 3.0, 0.2
"""Odometry does not cover gaps that last longer than this time [s] while the robot moves farther than this [m, rad]."""
SPAN_LENGTH, SPAN_TURN = 4.0, 1.0
"""Path [m] and rotation [rad] over which motions of odometry and of a trajectory are compared."""
NUM_PARTS, SCALE_T = 5, 2.776
"""Number of parts of a path whose scales are compared, and the factor of a 95 % interval (Student's t, 4 degrees of
freedom). Errors of a map are correlated over many metres: more parts give too narrow intervals."""


def follow_odometry(odometry: np.ndarray, scan_rows: np.ndarray, scan_poses: np.ndarray) -> np.ndarray:
    """Return a pose at each odometry time, shape (n, 3): the last scan's pose, continued by odometry [m, m, rad].

    `odometry`: odometry poses, shape (n, 3). `scan_rows`: index of each scan's odometry pose, shape (m,), ascending.
    `scan_poses`: shape (m, 3).
    """
    scan = np.maximum(np.searchsorted(scan_rows, np.arange(len(odometry)), side="right") - 1, 0)
    return compose_poses(scan_poses[scan], between_poses(odometry[scan_rows[scan]], odometry))


def odometry_scales(odometry: np.ndarray, poses: np.ndarray) -> tuple[float, float]:
    """Return the factors of distances and of turns that fit odometry to a trajectory best (least squares).

    They compare displacements over spans of `SPAN_LENGTH`, and turns over `SPAN_TURN`: SLAMs follow odometry from one
    key scan to the next, and then correct the pose. Both: shape (n, 3), at the same times. NaN if the robot has not
    driven, or not turned.
    """
    shift, true_shift = (each.ravel() for each in _displacements(odometry, poses))
    turns = [between_poses(each[:-1], each[1:])[:, 2] for each in (odometry, poses)]
    rows = _spans(turns[0], SPAN_TURN)
    turn, true_turn = (np.diff(np.concatenate([[0.0], np.cumsum(each)])[rows]) for each in turns)
    with np.errstate(invalid="ignore"):
        return float(shift @ true_shift / (shift @ shift)), float(turn @ true_turn / (turn @ turn))


def scale_std(odometry: np.ndarray, poses: np.ndarray) -> float:
    """Return the standard error of the factor of distances of `odometry_scales`; its 95 % interval is `SCALE_T` times.

    It follows from the residuals, summed over `NUM_PARTS` parts of the path, as errors are correlated along the path
    (Liang and Zeger, "Longitudinal data analysis", 1986). NaN for fewer than two spans per part.
    """
    shift, true_shift = _displacements(odometry, poses)
    if len(shift) < 2 * NUM_PARTS:
        return math.nan
    parts, whole = np.arange(len(shift)) * NUM_PARTS // len(shift), np.sum(shift * shift)
    scale = np.sum(shift * true_shift) / whole
    residuals = np.bincount(parts, np.sum(shift * (true_shift - scale * shift), axis=1))
    return float(np.sqrt(residuals @ residuals * NUM_PARTS / (NUM_PARTS - 1)) / whole)


def _displacements(odometry: np.ndarray, poses: np.ndarray) -> Iterator[np.ndarray]:
    """Return displacements over the spans of a path by odometry, then by poses, shape (spans, 2) [m].

    Steps of odometry have the headings of `poses`.
    """
    steps, c, s = between_poses(odometry[:-1], odometry[1:]), np.cos(poses[:-1, 2]), np.sin(poses[:-1, 2])
    path = np.cumsum([c * steps[:, 0] - s * steps[:, 1], s * steps[:, 0] + c * steps[:, 1]], axis=1).T
    rows = _spans(steps[:, 0], SPAN_LENGTH)
    return (np.diff(each[rows], axis=0) for each in (np.pad(path, ((1, 0), (0, 0))), poses[:, :2]))


def _spans(steps: np.ndarray, size: float) -> np.ndarray:
    """Return the rows that divide a path into parts of equal length, about `size`, as measured by absolute `steps`."""
    path = np.concatenate([[0.0], np.cumsum(np.abs(steps))])
    return np.unique(np.searchsorted(path, np.linspace(0.0, path[-1], max(round(path[-1] / size), 1) + 1)))


def find_gaps(times: np.ndarray, poses: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the times `at`, shape (m,), without odometry; return two masks, shape (m,), bool.

    The first marks times before or after all poses; the second, times in gaps, which are longer than `MAX_GAP` and have
    a motion above `MAX_GAP_MOTION`. `times`: shape (n,), ascending [s]. `poses`: shape (n, 3).
    """
    after = np.searchsorted(times, at)
    outside = (at < times[0]) | (at > times[-1])
    before, after = np.maximum(after - 1, 0), np.minimum(after, len(times) - 1)
    motion = np.maximum(*trajectory_errors(poses[after], poses[before]))
    in_gap = ~outside & (at < times[after]) & (times[after] - times[before] > MAX_GAP) & (motion > MAX_GAP_MOTION)
    return outside, in_gap


def interpolate_poses(times: np.ndarray, poses: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return poses at the times `at`, shape (m, 3), linear between those at `times`; see `find_gaps`."""
    x, y, theta = (np.interp(at, times, column) for column in (*poses.T[:2], np.unwrap(poses[:, 2])))
    return np.stack([x, y, wrap_angle(theta)], axis=1)


def save_trajectory(path: str | Path, times: np.ndarray, poses: np.ndarray) -> int:
    """Write times [s] and poses in TUM format: time, position, quaternion; return the number of left-out poses.

    Written times ascend strictly, as evo requires. Poses that are not finite, or whose written time repeats or runs
    back, are left out with a warning.
    """
    zero = np.zeros(len(times))
    x, y, theta = poses.T
    rows = np.stack([times, x, y, zero, zero, zero, np.sin(theta / 2), np.cos(theta / 2)], axis=1)
    rows = rows[np.isfinite(rows).all(axis=1)]
    written = np.char.mod("%.6f", rows[:, 0]).astype(np.float64)
    later = written > np.concatenate([[-np.inf], np.maximum.accumulate(written)[:-1]])
    earlier = written < np.concatenate([np.minimum.accumulate(written[::-1])[::-1][1:], [np.inf]])
    # One time far ahead ends the first series; one time far back, the second.
    rows = rows[max(later, earlier, key=np.sum)] if len(rows) else rows
    if left_out := len(times) - len(rows):
        why = "their times repeat or run back, or they are not finite"
        logging.getLogger(__name__).warning("%s: %d of %d poses are left out: %s", path, left_out, len(times), why)
    np.savetxt(path, rows, fmt="%.6f", header="time x y z qx qy qz qw")
    return left_out


def compose_poses(parent: np.ndarray, child: np.ndarray) -> np.ndarray:
    """Compose `parent` poses with relative `child` poses, shape (n, 3) [m, m, rad]."""
    c, s = np.cos(parent[:, 2]), np.sin(parent[:, 2])
    x = parent[:, 0] + c * child[:, 0] - s * child[:, 1]
    y = parent[:, 1] + s * child[:, 0] + c * child[:, 1]
    return np.stack([x, y, wrap_angle(parent[:, 2] + child[:, 2])], axis=1)


def trajectory_errors(poses: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return position errors [m] and absolute heading errors [rad] of `poses` relative to `truth`, shape (n, 3)."""
    return np.hypot(*(poses - truth)[:, :2].T), np.abs(wrap_angle(poses[:, 2] - truth[:, 2]))


def rms(values: np.ndarray) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def bridge_glitches(
    times: np.ndarray, poses: np.ndarray, max_speeds: tuple[float, float] = MAX_SPEEDS
) -> tuple[np.ndarray, list[str]]:
    """Replace odometry glitches (short jumps away and back) by interpolation; return corrected poses, and warnings.

    Both jumps exceed `max_speeds` (forward [m/s], yaw rate [rad/s]), at most 2 s or three periods apart. `times`: shape
    (n,), ascending except for jitter [s]. `poses`: odometry, shape (n, 3) [m, m, rad].
    """
    count, rows = len(times), np.arange(len(times) - 1)
    if count < 3 or not np.isfinite(times).all() or np.ptp(times) == 0.0:
        return poses, []
    low, high = np.maximum(rows - BURST, 0), np.minimum(rows + 1 + BURST, count - 1)
    clock = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(times)))])
    usual = (clock[high] - clock[low]) / (high - low)
    lengths, turns = trajectory_errors(poses[1:], poses[:-1])

    def is_possible(length: Any, turn: Any, duration: Any) -> Any:
        reach = duration + CLOCK_JITTER
        return (length <= max_speeds[0] * reach) & (turn <= max_speeds[1] * reach)

    jumps = rows[~is_possible(lengths, turns, np.maximum(np.diff(times), usual))].tolist()
    fixed, bridged, stay, done = poses.copy(), list[int](), list[int](), -1
    is_wrong = len(jumps) > max(MAX_IMPOSSIBLE * len(rows), 4)
    for k, jump in enumerate(jumps if not is_wrong else ()):
        if jump < done:
            continue
        longest = max(MAX_GLITCH, 3.0 * usual[jump])
        for end in jumps[k + 1 :]:
            after, duration = end + 1, times[end + 1] - times[jump]
            length, turn = (each.item() for each in trajectory_errors(poses[[after]], poses[[jump]]))
            if duration > longest or is_possible(length, turn, max(duration, usual[jump])):
                break
        else:
            duration = math.inf
        if duration > longest:
            stay.append(jump)
            continue
        share = np.clip((times[jump + 1 : after] - times[jump]) / max(duration, 1e-9), 0.0, 1.0)[:, None]
        motion = between_poses(poses[[jump]], poses[[after]])
        fixed[jump + 1 : after] = compose_poses(np.repeat(poses[[jump]], len(share), axis=0), share * motion)
        bridged += [jump] * len(share)
        done = after
    said, limits = [], f"{max_speeds[0]:g} m/s or {max_speeds[1]:g} rad/s"
    for found, fate in (
        (bridged, "poses are interpolated"),
        (stay, "jumps stay, do not trust a map beyond the first"),
        (jumps if is_wrong else [], f"of {len(rows)} motions are impossible; check stamps, units and limits (--robot)"),
    ):
        if found:
            k = found[0]
            step = f"{lengths[k]:.2f} m and {turns[k]:.2f} rad in {times[k + 1] - times[k]:.3f} s"
            said.append(f"odometry moves by {step} at {times[k + 1]:.3f} s, beyond {limits}: {len(found)} {fate}")
    return fixed, said


def describe_jump_back(times: np.ndarray, what: str) -> str:
    """Return a message on the first backward jump of `times` [s] by more than `MAX_CLOCK_JUMP`, empty without jump."""
    latest = np.maximum.accumulate(times)
    jumps = np.flatnonzero(latest - times > MAX_CLOCK_JUMP)
    if len(jumps) == 0:
        return ""
    return f"the clock runs back from {latest[jumps[0]]:.3f} to {times[jumps[0]]:.3f} s at {what} {jumps[0]}"

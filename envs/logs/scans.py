"""Conversion of recorded scans to a common set of beams."""

import math
import re
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from lidarnaut.envs.geometry.scan_resampling import SAME_POSITION, resample_scan
from lidarnaut.envs.robots.robot_params import MAX_BEAMS, MAX_LENGTH

from .trajectory import CLOCK_JITTER, interpolate_poses, trajectory_errors
from .transforms import seconds

MAX_RANGE_LIMIT = 1000.0
"""Maximum plausible range limit of a lidar [m]; some drivers report inf."""
SAME_BEAMS = 0.1
"""Beam angles that differ by less than this share of the angle increment count as equal."""
MANY_ZEROS = 0.1
"""Minimum share of ranges of 0.0 for advice on their meaning."""
MAX_SWEEP = 1.0
"""Maximum plausible duration of a scan [s]; some drivers give wrong `time_increment`s."""
MAX_SHARE_OF_INTERVAL = 2.0
"""Maximum plausible duration of a scan, divided by the usual time between scans, which varies."""
FULL_TURN, MAX_TURN = 2.0 * math.pi - 1e-6, 2.1 * math.pi
"""Minimum field of view of a full turn, and maximum valid field of view [rad]."""


class Scan(NamedTuple):
    """Recorded laser scan with beam angles in the base frame."""

    ranges: np.ndarray
    """Ranges, shape (num_beams,), float32 [m]."""
    first: float
    """Angle of the first beam [rad]."""
    step: float
    """Angle increment [rad]; negative for clockwise scans."""
    range_min: float
    """Minimum range [m]."""
    range_max: float
    """Maximum range [m]."""
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Position x, y, z of the lidar in the base frame [m]."""
    row: int | None = None
    """Index of the odometry pose at the scan; None to interpolate odometry at `time`."""
    time: float = math.nan
    """Stamp: time of the pose of the scan [s]."""
    time_increment: float = 0.0
    """Time between successive beams [s]; 0 for beams measured at once, negative if earlier beams are measured later."""
    delay: float = 0.0
    """Time of the first beam after the stamp [s]; 0 in messages."""

    @property
    def delays(self) -> np.ndarray:
        """Time of each beam after the stamp, shape (num_beams,), float64 [s]."""
        return self.delay + self.time_increment * np.arange(len(self.ranges))


class LogContent(NamedTuple):
    """Odometry and scans read from a log file."""

    times: np.ndarray
    """Odometry times, shape (n,), float64 [s]."""
    odometry: np.ndarray
    """Odometry poses x, y, heading, shape (n, 3), float64 [m, m, rad]."""
    scans: list[Scan]
    notes: list[str]
    """Warnings about the file, such as dropped scans."""
    reaches_limit: bool = False
    """Whether a range of exactly `range_max` is a return (REP 117)."""


class Limits(NamedTuple):
    """User-defined range limits [m]; None for the limits in scan headers."""

    min_range: float | None = None
    max_range: float | None = None

    def check(self) -> None:
        for name, value in self._asdict().items():
            if value is not None and not (0.0 <= value < math.inf and (value or name == "min_range")):
                raise ValueError(f"{name} (--{name.replace('_', '-')}) must be positive, got {value:g}")


def advise_on_zeros(num_zeros: int, num_clear: int, num_beams: int) -> str:
    """Return advice if a lidar seems to report no return as 0.0; empty if not. `num_clear`: beams without return."""
    if num_zeros < MANY_ZEROS * num_beams or num_zeros <= num_clear:
        return ""
    share = f"{100.0 * num_zeros / num_beams:.0f} % of the beams are 0.0, which counts as invalid and clears nothing"
    return f"{share}; if 0.0 is the lidar's no return, as the LDS-01's, set no_return to zero (--no-return zero)"


def number(message: Any, name: str) -> float:
    """Return a number of a message; NaN if it is null or absent."""
    value = getattr(message, name, None)
    return math.nan if value is None else float(value)


def scan_of(message: Any, null: float = math.nan) -> Scan:
    """Return the scan of a `sensor_msgs/LaserScan`, in the lidar's frame; ranges that are None become `null`."""
    given = [] if message.ranges is None else message.ranges
    with np.errstate(over="ignore"):  # out of range
        ranges = np.array(given, dtype=np.float32)
    if isinstance(given, list):
        ranges[np.array([each is None for each in given], dtype=bool)] = null
    return Scan(
        ranges,
        first=number(message, "angle_min"),
        step=number(message, "angle_increment"),
        range_min=number(message, "range_min"),
        range_max=number(message, "range_max"),
        time=seconds(message.header.stamp),
        time_increment=float(getattr(message, "time_increment", None) or 0.0),
    )


def in_base_frame(scan: Scan, mount: np.ndarray) -> Scan:
    """Return a scan of the lidar's frame in the base frame; an upside-down lidar turns the other way.

    `mount`: pose of the lidar in the base frame, shape (4, 4).
    """
    turn, sign = math.atan2(mount[1, 0], mount[0, 0]), math.copysign(1.0, mount[2, 2])
    return scan._replace(first=turn + sign * scan.first, step=sign * scan.step, position=tuple(mount[:3, 3].tolist()))


def usable_scans(scans: Iterable[Scan], limits: Limits) -> tuple[list[Scan], dict[str, list[str]]]:
    """Return the usable scans, with counter-clockwise beams, and error messages of the others, by kind of error.

    Raises:
        ValueError: no scan is usable.
    """
    kept: list[Scan] = []
    faults: dict[str, list[str]] = {}
    for scan in scans:
        scan, fault = _checked(scan, limits)
        if fault:
            faults.setdefault(re.sub(r"-?\d[^ ;]*|inf|nan", "", fault), []).append(fault)
        else:
            kept.append(scan)
    if not kept:
        raise ValueError(f"no scan can be used: {'; '.join(each[0] for each in faults.values()) or 'there are none'}")
    return kept, faults


def _checked(scan: Scan, limits: Limits) -> tuple[Scan, str]:
    low, high, count = float(scan.range_min), float(scan.range_max), len(scan.ranges)
    if low >= high and None not in limits:
        low = high = math.nan  # swapped
    if limits.min_range is not None and not low >= limits.min_range:
        low = limits.min_range
    if limits.max_range is not None:
        high = min(high, limits.max_range) if 0.0 < high <= MAX_RANGE_LIMIT else limits.max_range
    if not 0.0 < high <= MAX_RANGE_LIMIT:
        return scan, f"range limit of {high:g} m; set max_range (--max-range), at most {MAX_RANGE_LIMIT:g} m"
    if not 0.0 <= low < high:
        options = "set min_range (--min-range) and max_range (--max-range)"
        return scan, f"minimum range {low:g} m, maximum range {high:g} m; {options}"
    if not (math.isfinite(scan.first) and 0.0 < abs(scan.step) < math.inf):
        return scan, f"beams from {scan.first:g} rad in steps of {scan.step:g} rad"
    if not np.abs(scan.position).max() <= MAX_LENGTH:
        return scan, f"lidar at {scan.position} m in the base frame; at most {MAX_LENGTH:g} m is allowed"
    ranges, first, step = scan.ranges, scan.first, scan.step
    if FULL_TURN < abs(step) * (count - 1) < MAX_TURN:
        count = math.ceil(FULL_TURN / abs(step))
        ranges = ranges[:count]
    if not 2 <= count <= MAX_BEAMS:
        return scan, f"{count} beams; from 2 to {MAX_BEAMS:,} are allowed"
    if abs(step) * (count - 1) >= MAX_TURN:
        hint = "; are the angles in degrees?" if abs(step) * (count - 1) > 4.0 * math.pi else ""
        return scan, f"{len(scan.ranges)} beams in steps of {step:g} rad cover more than a turn{hint}"
    if step < 0.0:
        ranges, first, step = ranges[::-1], first + step * (count - 1), -step
        scan = scan._replace(time_increment=-scan.time_increment, delay=scan.time_increment * (count - 1))
    return scan._replace(ranges=ranges, first=first, step=step, range_min=low, range_max=high), ""


def with_checked_times(scan: Scan, interval: float) -> Scan:
    """Return a scan; without times of its beams if they take longer than the time between scans, `interval` [s]."""
    if abs(scan.time_increment) * (len(scan.ranges) - 1) <= min(MAX_SWEEP, MAX_SHARE_OF_INTERVAL * interval):
        return scan
    return scan._replace(time_increment=0.0, delay=0.0)


def deskewed(
    scans: Sequence[Scan], times: np.ndarray, odometry: np.ndarray, max_speeds: tuple[float, float], notes: list[str]
) -> list[Scan]:
    """Return scans whose beams are all measured at the stamp, corrected by odometry; add warnings to `notes`.

    `times`: shape (n,), ascending [s]. `odometry`: base poses at `times`, shape (n, 3) [m, m, rad]. Motions beyond
    `max_speeds` (forward [m/s], yaw rate [rad/s]) are jumps and not corrected.
    """
    intervals = np.diff([scan.time for scan in scans])
    interval = float(np.median(intervals[intervals > 0.0])) if (intervals > 0.0).any() else math.inf
    result = [with_checked_times(scan, interval) for scan in scans]
    if wrong := [scan.time_increment for scan, one in zip(scans, result) if one is not scan]:
        limit = f"{wrong[0]:g} s between beams, but {interval:.3g} s between scans (at most {MAX_SWEEP:g} s is allowed)"
        notes.append(f"time_increment of {len(wrong)} of {len(scans)} scans is ignored: {limit}")
    for k, scan in enumerate(result):
        if scan.time_increment != 0.0:
            at = scan.time + np.append(0.0, scan.delays)
            first, last = np.searchsorted(times, [at.min(), at.max()]).tolist()
            near = slice(max(first - 1, 0), last + 1)
            poses = interpolate_poses(times[near], odometry[near], at)
            motion = np.array([each.max() for each in trajectory_errors(poses[:1], poses)])
            if (motion <= np.multiply(max_speeds, np.ptp(at) + CLOCK_JITTER)).all():
                ranges = resampled(scan, scan.position, scan.first, scan.step, len(scan.ranges), poses)
                result[k] = scan._replace(ranges=ranges)
    return result


def common_beams(scans: Sequence[Scan]) -> tuple[np.ndarray, float, float, tuple[float, float, float]]:
    """Resample scans to common beam angles; return ranges, shape (m, num_beams), float32 [m], and the beam geometry.

    The geometry is first angle, angle increment [rad] and lidar position [m]. Ranges are interpolated between adjacent
    beams on one surface, else nearest; NaN outside of a scan's field of view. Scans of a moving lidar are shifted to
    the median position.
    """
    counts = np.array([len(scan.ranges) for scan in scans])
    steps, positions = np.array([scan.step for scan in scans]), np.array([scan.position for scan in scans])
    firsts = np.array([scan.first for scan in scans])
    fields = steps * (counts - 1)
    middles = firsts + 0.5 * fields
    firsts -= 2.0 * math.pi * np.rint((middles - middles[0]) / (2.0 * math.pi))
    lasts, tolerance = firsts + fields, SAME_BEAMS * steps[0]
    is_same = np.ptp(counts) == 0 and max(np.ptp(firsts), np.ptp(lasts)) <= tolerance
    if is_same and np.ptp(positions, axis=0).max() <= SAME_POSITION:
        return np.stack([scan.ranges for scan in scans]), scans[0].first, scans[0].step, scans[0].position
    x, y, z = np.median(positions, axis=0).tolist()
    step, low = float(np.quantile(steps, 0.1, method="lower")), float(firsts.min())
    num_beams = math.floor((lasts.max() - low) / step + 1.5)
    if step * (num_beams + 0.5) > 2.0 * math.pi:
        num_beams = round(2.0 * math.pi / step)
        step = 2.0 * math.pi / num_beams
    if num_beams > MAX_BEAMS:
        raise ValueError(f"scans need {num_beams:,} common beams; at most {MAX_BEAMS:,} are allowed")
    return np.stack([resampled(scan, (x, y), low, step, num_beams) for scan in scans]), low, step, (x, y, z)


def resampled(
    scan: Scan, position: Sequence[float], low: float, step: float, num_beams: int, poses: np.ndarray | None = None
) -> np.ndarray:
    """Return a scan as a lidar at another position would measure it, shape (num_beams,), float32 [m].

    `position`: x, y [m]. `low`, `step`: first angle and angle increment [rad]. `poses`: see `resample_scan`.
    """
    angles, beams = scan.first + scan.step * np.arange(len(scan.ranges)), (low, step, num_beams)
    return resample_scan(scan.ranges, angles, scan.position[:2], position[:2], beams, poses)

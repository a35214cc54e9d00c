"""Logs of real robots: wheel odometry and laser scans."""

import itertools
import logging
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lidarnaut.envs.files import printable
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.robots import LidarParams, Mount

from .bag import is_bag, read_bag
from .readers import read_archive, read_carmen
from .scans import Limits, LogContent, Scan, advise_on_zeros, common_beams, deskewed, usable_scans
from .trajectory import MAX_SPEEDS, bridge_glitches, describe_jump_back, find_gaps, interpolate_poses

MAX_STEP = 100.0
"""Maximum odometry distance between successive scans of a valid log [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Log:
    """Recorded drive of a robot: wheel odometry and laser scans."""

    times: np.ndarray
    """Odometry times, shape (n,), float64 [s]."""
    odometry: np.ndarray
    """Base pose x, y, heading by wheel odometry, shape (n, 3), float64 [m, m, rad]."""
    scan_rows: np.ndarray
    """Index of each scan in `times` and `odometry`, shape (m,), int64."""
    ranges: np.ndarray
    """Scan ranges, shape (m, num_beams), float32 [m]; +inf for no return, NaN for ignored beams."""
    lidar: LidarParams
    """Lidar geometry: beams, range limits and mount."""
    notes: tuple[str, ...] = ()
    """Warnings about dropped scans, interpolated odometry and assumptions."""

    def motions(self) -> Iterator[Pose2D]:
        """Yield each scan's odometry pose relative to the previous scan [m, m, rad]."""
        poses = [Pose2D(*row) for row in self.odometry[self.scan_rows].tolist()]
        yield Pose2D(0.0, 0.0, 0.0)
        for before, after in itertools.pairwise(poses):
            yield before.between(after)

    @property
    def step_length(self) -> float:
        """Median odometry distance between successive scans while moving [m]; 0 without motion."""
        steps = np.hypot(*np.diff(self.odometry[self.scan_rows, :2], axis=0).T)
        moving = steps[steps > 0.01]
        return float(np.median(moving)) if len(moving) else 0.0

    def thinned(self, distance: float, angle: float) -> "Log":
        """Return a log of scans at least `distance` [m] or `angle` [rad] apart by odometry."""
        poses = [Pose2D(*row) for row in self.odometry[self.scan_rows].tolist()]
        kept = [0]
        for k, pose in enumerate(poses):
            motion = poses[kept[-1]].between(pose)
            if math.hypot(motion.x, motion.y) >= distance or abs(motion.theta) >= angle:
                kept.append(k)
        return replace(self, scan_rows=self.scan_rows[kept], ranges=self.ranges[kept])

    def __post_init__(self) -> None:
        if len(self.times) != len(self.odometry) or len(self.scan_rows) != len(self.ranges):
            raise ValueError("numbers of times, poses and scans do not agree")
        if len(self.ranges) == 0:
            raise ValueError("holds no scans")
        finite = np.isfinite(self.times) & np.isfinite(self.odometry).all(axis=1)
        if not finite.all():
            row = int(finite.argmin())
            pose = self.odometry[row].tolist()
            raise ValueError(f"times and odometry must be finite, row {row} is {self.times[row]} s, {pose}")
        if self.scan_rows.min() < 0 or self.scan_rows.max() >= len(self.times):
            raise ValueError("scans refer to rows of odometry that do not exist")
        if (self.ranges < 0.0).any():
            scan, beam = np.argwhere(self.ranges < 0.0)[0].tolist()
            raise ValueError(f"ranges must not be negative, beam {beam} of scan {scan} is {self.ranges[scan, beam]} m")
        steps = np.hypot(*np.diff(self.odometry[self.scan_rows, :2], axis=0).T)
        if (steps > MAX_STEP).any():
            scan = int((steps > MAX_STEP).argmax())
            moved = f"odometry moves by {steps[scan]:g} m from scan {scan} to the next"
            raise ValueError(f"{moved}; at most {MAX_STEP:g} m is allowed")
        if fault := describe_jump_back(self.times[self.scan_rows], "scan"):
            raise ValueError(fault)


def load_log(
    path: str | Path,
    max_range: float | None = None,
    *,
    min_range: float | None = None,
    field_of_view: float | None = None,
    scan_topic: str | None = None,
    odom_topic: str | None = None,
    base_frame: str | None = None,
    odom_frame: str | None = None,
    laser_frame: str | None = None,
    max_speeds: tuple[float, float] = MAX_SPEEDS,
    no_return: str = "inf",
) -> Log:
    """Read a log: arrays (.npz), CARMEN text (.log, .clf, also gzipped), or a ROS 1 or ROS 2 bag.

    Unusable scans are dropped and impossible odometry motions interpolated, with warnings and `Log.notes`.

    Args:
        path: file or ROS 2 bag folder. Arrays: `t`, `odo`, `idx`, `ranges` (`times`, `odometry`, `scan_rows`, `ranges`
            of `Log`); `ang0`, `dang`, first angle and increment in the base frame [rad]; `maxr`, maximum range [m];
            optional `mount_x`, lidar position [m], and `off`, added to `t`.
        max_range: readings of at least this range are no return [m]; default: the log's limit.
        min_range: readings below this range are ignored [m]; default: the log's limit.
        field_of_view: angle of CARMEN's FLASER scans [rad]; default: see `read_carmen`.
        scan_topic: scan topic of a bag, if several.
        odom_topic: odometry topic of a bag, if several.
        base_frame: base frame of a bag; default: child frame of the odometry.
        odom_frame: odometry frame of a bag; default: frame of the messages, or `odom`.
        laser_frame: lidar frame of a bag, if ambiguous or named differently in transforms.
        max_speeds: the robot's maximum forward speed [m/s] and yaw rate [rad/s].
        no_return: meaning of ranges of 0.0, see `LidarParams.no_return`.

    Raises:
        FileNotFoundError: no such file.
        ValueError: unknown or damaged file, no usable scan, or invalid option.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"no log at {path}")
    of_bags = {
        "scan_topic": scan_topic,
        "odom_topic": odom_topic,
        "base_frame": base_frame,
        "odom_frame": odom_frame,
        "laser_frame": laser_frame,
    }
    if no_return not in ("inf", "zero"):
        raise ValueError(f"no_return must be 'inf' or 'zero', got {no_return!r}")
    recording = _read_content(path, field_of_view, of_bags)
    try:
        log = _make_log(recording, Limits(min_range, max_range), max_speeds, no_return)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    for note in log.notes:
        logging.getLogger(__name__).warning("%s", printable(f"{path}: {note}"))
    return log


def _read_content(path: Path, field_of_view: float | None, of_bags: dict[str, str | None]) -> LogContent:
    is_carmen = path.name.endswith((".log", ".log.gz", ".clf", ".clf.gz")) and path.is_file()
    if chosen := [name for name, value in of_bags.items() if value is not None and not is_bag(path)]:
        raise ValueError(f"{path}: {chosen[0]} (--{chosen[0].replace('_', '-')}) applies to bags only")
    if field_of_view is not None and not (is_carmen and 0.0 < field_of_view <= 2.0 * math.pi):
        allowed = "for CARMEN logs only, in (0, 2 pi] rad"
        raise ValueError(f"{path}: field_of_view (--field-of-view) is {allowed}, got {field_of_view:g}")
    if is_bag(path):
        return read_bag(path, **of_bags)
    if path.suffix == ".npz":
        return read_archive(path)
    if is_carmen:
        return read_carmen(path, field_of_view)
    known = ".npz, .log, .log.gz, .clf, .clf.gz, .bag, .mcap and folders with metadata.yaml"
    raise ValueError(f"{path}: unknown type of log; known types are {known}")


def _make_log(recording: LogContent, limits: Limits, max_speeds: tuple[float, float], no_return: str) -> Log:
    limits.check()
    scans, faults = usable_scans(recording.scans, limits)
    of_all = f"of {len(recording.scans)} scans are left out"
    notes = [*recording.notes, *(f"{len(each)} {of_all}: {each[0]}" for each in faults.values())]
    times, (odometry, glitches) = recording.times, bridge_glitches(recording.times, recording.odometry, max_speeds)
    if scans[0].row is None:
        scans, times, odometry, rows = _interpolated(scans, times, odometry, of_all, notes)
    else:
        rows = np.array([scan.row for scan in scans])
    readings = [_read(scan, recording.reaches_limit and limits.max_range is None, no_return) for scan in scans]
    num_zeros = int(sum((scan.ranges == 0.0).sum() for scan in scans))
    num_clear = int(sum((scan.ranges == np.inf).sum() for scan in readings))
    if no_return == "inf" and (advice := advise_on_zeros(num_zeros, num_clear, sum(len(one.ranges) for one in scans))):
        notes.append(advice)
    readings = deskewed(readings, times, odometry, max_speeds, notes)
    ranges, first, step, (x, y, z) = common_beams(readings)
    low, high = min(scan.range_min for scan in scans), max(scan.range_max for scan in scans)
    fov = step * (ranges.shape[1] - 1)
    lidar = LidarParams(ranges.shape[1], high, low, fov, mount=Mount(x, y, z, yaw=first + fov / 2))
    if not np.isfinite(ranges).any():
        notes.append("no beam of any scan has a return")
    return Log(times, odometry, rows.astype(np.int64), ranges, lidar, tuple(notes + glitches))


def _interpolated(
    scans: list[Scan], times: np.ndarray, odometry: np.ndarray, of_all: str, notes: list[str]
) -> tuple[list[Scan], np.ndarray, np.ndarray, np.ndarray]:
    scan_times = np.array([scan.time for scan in scans])
    outside, in_gap = find_gaps(times, odometry, scan_times)
    spans = [f"{each.min():.3f} to {each.max():.3f} s" for each in (scan_times, times)]
    if (outside | in_gap).all():
        raise ValueError(f"scans from {spans[0]} and odometry from {spans[1]} do not overlap")
    early_or_late = f"outside the time of the odometry, {spans[1]}"
    reasons = (outside, early_or_late), (in_gap, "the robot moves in gaps of the odometry")
    notes += [f"{is_out.sum()} {of_all}: {why}" for is_out, why in reasons if is_out.any()]
    inside = ~(outside | in_gap)
    every = np.union1d(times, scan_times[inside])
    kept = [scan for scan, is_inside in zip(scans, inside.tolist()) if is_inside]
    return kept, every, interpolate_poses(times, odometry, every), np.searchsorted(every, scan_times[inside])


def _read(scan: Scan, reaches_limit: bool, no_return: str) -> Scan:
    ranges = scan.ranges
    is_return = ranges <= scan.range_max if reaches_limit else ranges < scan.range_max
    ranges = np.where(is_return | np.isnan(ranges), ranges, np.float32(np.inf))
    ranges[((ranges < scan.range_min) & (ranges >= 0.0)) | (ranges == 0.0)] = np.nan
    if no_return == "zero":
        ranges[scan.ranges == 0.0] = np.inf
    return scan._replace(ranges=ranges)

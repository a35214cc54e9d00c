"""Logs of real robots: wheel odometry and laser scans."""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.robots import LidarParams, Mount
from lidarnaut.envs.robots.params import MAX_BEAMS

from .bag import is_bag, read_bag
from .readers import read_archive, read_carmen
from .trajectory import find_jump_back

MAX_RANGE_LIMIT = 1000.0
"""A range limit above this is no lidar's [m]: drivers that do not know theirs say inf, or the largest number."""
MAX_STEP = 100.0
"""Odometry that moves farther from one scan to the next, or a lidar farther from the base, is damaged [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Log:
    """What a robot recorded on a drive."""

    times: np.ndarray
    """Shape (n,), float64: when odometry was read [s]; clocks may jump back a little."""
    odometry: np.ndarray
    """Shape (n, 3), float64: pose of the base by its wheels, x, y, heading [m, rad]."""
    scan_rows: np.ndarray
    """Shape (m,), int64: rows of `times` and `odometry` at which the scans were taken."""
    ranges: np.ndarray
    """Shape (m, num_beams), float32 [m]; +inf for no return, NaN for a beam to ignore."""
    lidar: LidarParams
    """Geometry of the scans."""

    def motions(self) -> Iterator[Pose2D]:
        """Yield for each scan the pose of the base by odometry, seen from the base at the scan before."""
        poses = [Pose2D(*row) for row in self.odometry[self.scan_rows].tolist()]
        yield Pose2D(0.0, 0.0, 0.0)
        for before, after in itertools.pairwise(poses):
            yield before.between(after)

    @property
    def step_length(self) -> float:
        """Median distance from one scan to the next by odometry [m], of a robot that moves; 0 for one that does not."""
        steps = np.hypot(*np.diff(self.odometry[self.scan_rows, :2], axis=0).T)
        moving = steps[steps > 0.01]
        return float(np.median(moving)) if len(moving) else 0.0

    def thinned(self, distance: float, angle: float) -> "Log":
        """Return a log with key scans alone: `distance` [m] or `angle` [rad] or more by odometry after the last one."""
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
            raise ValueError(
                f"odometry moves by {steps[scan]:g} m from scan {scan} to the next, at most {MAX_STEP:g} m"
            )
        times = self.times[self.scan_rows]
        jump = find_jump_back(times)
        if jump is not None:
            latest = times[:jump].max()
            raise ValueError(f"the clock runs back from {latest:.3f} to {times[jump]:.3f} s at scan {jump}")


def load_log(
    path: str | Path,
    max_range: float | None = None,
    *,
    scan_topic: str | None = None,
    odom_topic: str | None = None,
) -> Log:
    """Read a log: arrays (.npz), CARMEN text (.log, .clf, also gzipped), or a ROS 1 or ROS 2 bag.

    Args:
        path: the file, or the folder of a ROS 2 bag. Arrays are `t`, `odo`, `idx` and `ranges`, see the fields of
            `Log`; `ang0` and `dang`, the angle of the first beam in the base frame and from one beam to the next [rad];
            `maxr`, the range from which there is no return [m]; optionally `mount_x`, the lidar's position in the base
            frame [m], and `off`, added to `t`. Bags: see `read_bag`.
        max_range: readings from this on count as no return [m]; None takes what the log says.
        scan_topic: topic of the scans in a bag; None for the only one.
        odom_topic: topic of the odometry in a bag; None for the only one.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is of another kind, damaged, or holds no scans, or values that make no sense; the message
            names the file and the place.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"no log at {path}")
    if is_bag(path):
        arrays = read_bag(path, scan_topic, odom_topic)
    elif scan_topic or odom_topic:
        raise ValueError(f"{path}: topics can be chosen in bags only")
    elif path.suffix == ".npz":
        arrays = read_archive(path)
    elif path.name.endswith((".log", ".log.gz", ".clf", ".clf.gz")) and path.is_file():
        arrays = read_carmen(path)
    else:
        known = ".npz, .log, .log.gz, .clf, .clf.gz, .bag, .mcap and folders with metadata.yaml"
        raise ValueError(f"{path}: unknown kind of log; {known} are known")
    try:
        return _make_log(arrays, max_range)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _make_log(arrays: dict[str, Any], max_range: float | None) -> Log:
    """Make a log of what the readers return: the arrays of `load_log`; bags have more of the mount, and `minr`."""
    ranges, step = arrays["ranges"].astype(np.float32), float(arrays["dang"])
    if max_range is not None and not max_range > 0.0:
        raise ValueError(f"max_range (--max-range) must be positive, got {max_range:g}")
    limit = float(arrays["maxr"]) if max_range is None else min(float(arrays["maxr"]), max_range)
    if not 0.0 < limit <= MAX_RANGE_LIMIT:
        allowed = f"(0, {MAX_RANGE_LIMIT:g}]; max_range (--max-range) sets one"
        raise ValueError(f"the range limit (maxr) is {limit:g} m, it must lie in {allowed}")
    mount_x, mount_y, mount_z = (float(arrays.get(f"mount_{axis}", 0.0)) for axis in "xyz")
    if not (math.isfinite(arrays["ang0"]) and 0.0 < step < math.inf and abs(mount_x) <= MAX_STEP):
        raise ValueError(f"beams start at {float(arrays['ang0'])} rad in steps of {step} rad, {mount_x} m ahead")
    if step * (ranges.shape[1] - 1) > 2 * math.pi - 1e-6:
        ranges = ranges[:, :-1]  # the last beam of a full turn repeats the first
    num_beams = ranges.shape[1]
    if not 1 <= num_beams <= MAX_BEAMS:
        raise ValueError(f"scans have {num_beams} beams, from 1 to {MAX_BEAMS:,} are allowed")
    fov = step * (num_beams - 1)
    # LidarParams centres the field of view on the sensor's x axis.
    mount = Mount(mount_x, mount_y, mount_z, yaw=float(arrays["ang0"]) + fov / 2)
    lidar = LidarParams(num_beams, limit, float(arrays.get("minr", 0.0)), fov, mount=mount)
    is_return = ranges <= limit if "minr" in arrays and max_range is None else ranges < limit
    ranges = np.where(is_return | np.isnan(ranges), ranges, np.float32(np.inf))
    times, odometry = (arrays[name].astype(np.float64) for name in ("t", "odo"))
    return Log(times, odometry, arrays["idx"].astype(np.int64), ranges, lidar)

"""Logs of real robots: wheel odometry and laser scans."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from envs.geometry import Pose2D
from envs.robots import LidarParams, Mount

from .carmen import RawLog, read_carmen


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
    """Shape (m, num_beams), float32 [m]; +inf for no return."""
    lidar: LidarParams
    """Geometry of the scans."""

    def motions(self) -> Iterator[Pose2D]:
        """Yield for each scan the pose of the base by odometry, seen from the base at the scan before."""
        poses = [Pose2D(*row) for row in self.odometry[self.scan_rows].tolist()]
        yield Pose2D(0.0, 0.0, 0.0)
        for before, after in itertools.pairwise(poses):
            yield before.between(after)

    def __post_init__(self) -> None:
        if len(self.times) != len(self.odometry) or len(self.scan_rows) != len(self.ranges):
            raise ValueError("numbers of times, poses and scans do not agree")
        if len(self.ranges) == 0:
            raise ValueError("holds no scans")
        if not (np.isfinite(self.times).all() and np.isfinite(self.odometry).all()):
            raise ValueError("times and odometry must be finite")
        if self.scan_rows.min() < 0 or self.scan_rows.max() >= len(self.times):
            raise ValueError("scans refer to rows of odometry that do not exist")


def load_log(path: str | Path, max_range: float | None = None) -> Log:
    """Read a log, either arrays (.npz) or CARMEN text (.log, .clf, also gzipped).

    Args:
        path: the file. Arrays are named `t`, `odo`, `ranges`, `idx`, `ang0`, `dang`, `maxr` and optionally `off`, which
            is added to `t`.
        max_range: readings from this on count as no return [m]; None takes what the log says.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is of another kind, damaged, or holds no scans.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no log at {path}")
    if path.suffix == ".npz":
        raw = _read_arrays(path)
    elif path.name.endswith((".log", ".log.gz", ".clf", ".clf.gz")):
        raw = read_carmen(path)
    else:
        raise ValueError(f"{path}: unknown kind of log; .npz, .log, .log.gz, .clf and .clf.gz are known")
    limit = raw.max_range if max_range is None else min(raw.max_range, max_range)
    num_beams = raw.ranges.shape[-1]
    fov = raw.increment * (num_beams - 1)
    # LidarParams centres the field of view on the sensor's x axis.
    lidar = LidarParams(num_beams, limit, fov=fov, mount=Mount(raw.mount_x, yaw=raw.angle_min + fov / 2))
    ranges = np.where(raw.ranges >= limit, np.float32(np.inf), raw.ranges.astype(np.float32))
    try:
        return Log(raw.times, raw.odometry, raw.scan_rows.astype(np.int64), ranges, lidar)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _read_arrays(path: Path) -> RawLog:
    with np.load(path) as arrays:
        if missing := {"t", "odo", "ranges", "idx", "ang0", "dang", "maxr"} - set(arrays):
            raise ValueError(f"{path}: lacks the arrays {sorted(missing)}")
        times = arrays["t"] + (float(arrays["off"]) if "off" in arrays else 0.0)
        angles = float(arrays["ang0"]), float(arrays["dang"])
        return RawLog(times, arrays["odo"], arrays["idx"], arrays["ranges"], *angles, float(arrays["maxr"]))

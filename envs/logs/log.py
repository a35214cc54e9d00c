"""Logs of real robots: wheel odometry and laser scans."""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from envs.geometry import Pose2D
from envs.robots import LidarParams, Mount

from .carmen import read_carmen


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
        path: the file. Arrays are `t`, `odo`, `idx` and `ranges`, see the fields of `Log`; `ang0` and `dang`, the angle
            of the first beam in the base frame and from one beam to the next [rad]; `maxr`, the range from which there
            is no return [m]; optionally `mount_x`, the lidar's position in the base frame [m], and `off`, added to `t`.
        max_range: readings from this on count as no return [m]; None takes what the log says.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is of another kind, damaged, or holds no scans.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no log at {path}")
    if path.suffix == ".npz":
        with np.load(path) as archive:
            arrays = dict(archive)
        if missing := {"t", "odo", "ranges", "idx", "ang0", "dang", "maxr"} - set(arrays):
            raise ValueError(f"{path}: lacks the arrays {sorted(missing)}")
    elif path.name.endswith((".log", ".log.gz", ".clf", ".clf.gz")):
        arrays = read_carmen(path)
    else:
        raise ValueError(f"{path}: unknown kind of log; .npz, .log, .log.gz, .clf and .clf.gz are known")
    limit = min(float(arrays["maxr"]), math.inf if max_range is None else max_range)
    fov = float(arrays["dang"]) * (arrays["ranges"].shape[-1] - 1)
    # LidarParams centres the field of view on the sensor's x axis.
    mount = Mount(float(arrays.get("mount_x", 0.0)), yaw=float(arrays["ang0"]) + fov / 2)
    lidar = LidarParams(arrays["ranges"].shape[-1], limit, fov=fov, mount=mount)
    ranges = np.where(arrays["ranges"] >= limit, np.float32(np.inf), arrays["ranges"].astype(np.float32))
    times = arrays["t"] + float(arrays.get("off", 0.0))
    try:
        return Log(times, arrays["odo"], arrays["idx"].astype(np.int64), ranges, lidar)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error

"""Logs of real robots: wheel odometry and laser scans."""

import gzip
import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from envs.geometry import Pose2D
from envs.robots import LidarParams, Mount


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


def load_log(path: str | Path, max_range: float | None = None) -> Log:
    """Read a log, either arrays (.npz) or CARMEN text (.log, .log.gz, .clf).

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
        return _read_arrays(path, max_range)
    if path.name.endswith((".log", ".log.gz", ".clf", ".clf.gz")):
        return _read_carmen(path, max_range)
    raise ValueError(f"{path}: unknown kind of log; .npz, .log, .log.gz, .clf and .clf.gz are known")


def _log(
    path: Path,
    times: np.ndarray,
    odometry: np.ndarray,
    scan_rows: np.ndarray,
    ranges: np.ndarray,
    angle_min: float,
    increment: float,
    max_range: float,
    mount_x: float = 0.0,
) -> Log:
    """Put a log together and check it."""
    if not len(times) == len(odometry) or not len(scan_rows) == len(ranges):
        raise ValueError(f"{path}: numbers of times, poses and scans do not agree")
    if len(ranges) == 0:
        raise ValueError(f"{path}: holds no scans")
    if not (np.isfinite(times).all() and np.isfinite(odometry).all()):
        raise ValueError(f"{path}: times and odometry must be finite")
    if scan_rows.min() < 0 or scan_rows.max() >= len(times):
        raise ValueError(f"{path}: scans refer to rows of odometry that do not exist")
    num_beams = ranges.shape[1]
    fov = increment * (num_beams - 1)
    yaw = angle_min + fov / 2  # LidarParams centres the field of view on the sensor's x axis
    lidar = LidarParams(num_beams, max_range, fov=fov, mount=Mount(mount_x, yaw=yaw))
    ranges = np.where(ranges >= max_range, np.float32(np.inf), ranges.astype(np.float32))
    return Log(times, odometry, scan_rows.astype(np.int64), ranges, lidar)


def _read_arrays(path: Path, max_range: float | None) -> Log:
    with np.load(path) as arrays:
        if missing := {"t", "odo", "ranges", "idx", "ang0", "dang", "maxr"} - set(arrays):
            raise ValueError(f"{path}: lacks the arrays {sorted(missing)}")
        offset = float(arrays["off"]) if "off" in arrays else 0.0
        limit = float(arrays["maxr"])
        return _log(
            path,
            arrays["t"] + offset,
            arrays["odo"],
            arrays["idx"],
            arrays["ranges"],
            float(arrays["ang0"]),
            float(arrays["dang"]),
            limit if max_range is None else min(limit, max_range),
        )


_SICK_MAX_RANGE = 80.0
"""Range of the laser that FLASER lines come from, which do not tell theirs [m]."""


def _read_carmen(path: Path, max_range: float | None) -> Log:
    """Read ODOM, FLASER and ROBOTLASER1 lines (one kind of laser per log)."""
    times, odometry, scan_rows, scans = [], [], [], []
    geometry: tuple[float, float] | None = None
    limit = _SICK_MAX_RANGE
    mount_x = 0.0
    opener = gzip.open if path.suffix == ".gz" else open
    with opener(path, "rt", encoding="ascii", errors="replace") as file:
        for number, line in enumerate(file, start=1):
            kind, *fields = line.split() or [""]
            try:
                if kind == "ODOM":
                    pose = fields[0:3]
                elif kind == "FLASER":
                    count = int(fields[0])
                    scan, pose = fields[1 : 1 + count], fields[4 + count : 7 + count]
                    geometry = (-math.pi / 2, math.radians(_sick_step(count)))
                elif kind == "ROBOTLASER1":
                    count = int(fields[7])
                    scan = fields[8 : 8 + count]
                    after = 9 + count + int(fields[8 + count])
                    laser, pose = [float(value) for value in fields[after : after + 3]], fields[after + 3 : after + 6]
                    geometry = (float(fields[1]), float(fields[3]))
                    limit = float(fields[4])
                    mount_x = math.hypot(laser[0] - float(pose[0]), laser[1] - float(pose[1]))
                elif kind == "PARAM" and fields[0] == "robot_frontlaser_offset":
                    mount_x = float(fields[1])
                    continue
                else:
                    continue
                times.append(float(fields[-3]))
                odometry.append([float(value) for value in pose])
                if len(odometry[-1]) != 3:
                    raise ValueError("the pose is cut off")
                if kind != "ODOM":
                    scan_rows.append(len(times) - 1)
                    scans.append(np.array(scan, dtype=np.float32))
                    if len(scans[-1]) != len(scans[0]):
                        raise ValueError(f"{len(scans[-1])} beams where earlier scans have {len(scans[0])}")
            except (ValueError, IndexError) as error:
                raise ValueError(f"{path}, line {number}: bad {kind} line: {error}") from error
    if geometry is None:
        raise ValueError(f"{path}: holds no FLASER or ROBOTLASER1 lines")
    return _log(
        path,
        np.array(times),
        np.array(odometry),
        np.array(scan_rows),
        np.array(scans),
        *geometry,
        limit if max_range is None else min(limit, max_range),
        mount_x,
    )


def _sick_step(num_beams: int) -> float:
    """Return the angle between the beams of a SICK scan over half a turn [deg]."""
    return 1.0 if num_beams <= 181 else 0.5

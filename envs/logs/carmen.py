"""Logs as CARMEN text (.log, .clf, also gzipped)."""

import gzip
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np


class RawLog(NamedTuple):
    """A log as it was recorded; see `Log`."""

    times: np.ndarray
    odometry: np.ndarray
    scan_rows: np.ndarray
    ranges: np.ndarray
    angle_min: float
    """Direction of the first beam in the base frame [rad]."""
    increment: float
    """Angle between two beams [rad]."""
    max_range: float
    """Readings from this on are no return [m]."""
    mount_x: float = 0.0
    """Position of the lidar along the x axis of the base [m]."""


_SICK_MAX_RANGE = 80.0
"""Range of the SICK lasers behind FLASER lines, which do not record it [m]."""


def read_carmen(path: Path) -> RawLog:
    """Read the ODOM, FLASER and ROBOTLASER1 lines of a log with one kind of laser."""
    times, odometry, scan_rows, scans = [], [], [], []
    angles: tuple[float, float] | None = None
    limit, mount_x = _SICK_MAX_RANGE, 0.0
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
                    # Half a turn in steps of 1 or 0.5 degrees.
                    angles = (-math.pi / 2, math.radians(1.0 if count <= 181 else 0.5))
                elif kind == "ROBOTLASER1":
                    count = int(fields[7])
                    scan = fields[8 : 8 + count]
                    after = 9 + count + int(fields[8 + count])
                    laser, pose = [float(value) for value in fields[after : after + 3]], fields[after + 3 : after + 6]
                    angles = (float(fields[1]), float(fields[3]))
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
    if angles is None:
        raise ValueError(f"{path}: holds no FLASER or ROBOTLASER1 lines")
    return RawLog(np.array(times), np.array(odometry), np.array(scan_rows), np.array(scans), *angles, limit, mount_x)

"""Logs as CARMEN text (.log, .clf, also gzipped)."""

import gzip
import math
from pathlib import Path
from typing import Any

import numpy as np

_SICK_MAX_RANGE = 80.0
"""Range of the SICK lasers behind FLASER lines, which do not record it [m]."""


def read_carmen(path: Path) -> dict[str, Any]:
    """Read the ODOM, FLASER and ROBOTLASER1 lines of a log with one kind of laser, as the arrays of `load_log`."""
    times, odometry, scan_rows, scans = [], [], [], []
    lidar = {"maxr": _SICK_MAX_RANGE, "mount_x": 0.0}
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
                    lidar |= {"ang0": -math.pi / 2, "dang": math.radians(1.0 if count <= 181 else 0.5)}
                elif kind == "ROBOTLASER1":
                    count = int(fields[7])
                    scan = fields[8 : 8 + count]
                    after = 9 + count + int(fields[8 + count])
                    laser, pose = [float(value) for value in fields[after : after + 3]], fields[after + 3 : after + 6]
                    lidar |= {"ang0": float(fields[1]), "dang": float(fields[3]), "maxr": float(fields[4])}
                    lidar["mount_x"] = math.hypot(laser[0] - float(pose[0]), laser[1] - float(pose[1]))
                elif kind == "PARAM" and fields[0] == "robot_frontlaser_offset":
                    lidar["mount_x"] = float(fields[1])
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
    if not scans:
        raise ValueError(f"{path}: holds no FLASER or ROBOTLASER1 lines")
    arrays = {"t": times, "odo": odometry, "idx": scan_rows, "ranges": scans}
    return {name: np.array(values) for name, values in arrays.items()} | lidar

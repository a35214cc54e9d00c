"""Logs as CARMEN text (.log, .clf, also gzipped), and as NumPy archives (.npz)."""

import gzip
import math
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from lidarnaut.envs.files import open_archive

_DIMENSIONS = {"t": 1, "odo": 2, "idx": 1, "ranges": 2, "ang0": 0, "dang": 0, "maxr": 0}
_OPTIONAL = {"mount_x": 0, "off": 0}
_SICK_MAX_RANGE = 80.0
"""Range of the SICK lasers behind FLASER lines, which do not record it [m]."""
MAX_LINE = 1_000_000
"""Longest line [characters]."""
MAX_TEXT = 2**30
"""Longest text [characters]; a small gzipped file can unpack to any size."""


def read_carmen(path: Path) -> dict[str, Any]:
    """Read the ODOM, FLASER and ROBOTLASER1 lines of a log with one kind of laser, as the arrays of `load_log`.

    Raises:
        ValueError: a line is damaged, the file is cut off, or there are no scans.
    """
    times, odometry, scan_rows, scans = [], [], [], []
    lidar = {"maxr": _SICK_MAX_RANGE, "mount_x": 0.0}
    for number, line in enumerate(_lines(path), start=1):
        kind, *fields = line.split() or [""]
        try:
            if kind == "ODOM":
                pose, num_fields = fields[0:3], 9
            elif kind == "FLASER":
                count = int(fields[0])
                scan, pose, num_fields = fields[1 : 1 + count], fields[4 + count : 7 + count], count + 10
                # Half a turn in steps of 1 or 0.5 degrees.
                lidar |= {"ang0": -math.pi / 2, "dang": math.radians(1.0 if count <= 181 else 0.5)}
            elif kind == "ROBOTLASER1":
                count = int(fields[7])
                scan = fields[8 : 8 + count]
                after = 9 + count + int(fields[8 + count])
                laser, pose = _numbers(fields[after : after + 3]), fields[after + 3 : after + 6]
                lidar |= {"ang0": float(fields[1]), "dang": float(fields[3]), "maxr": float(fields[4])}
                num_fields = after + 14
                lidar["mount_x"] = math.hypot(laser[0] - float(pose[0]), laser[1] - float(pose[1]))
            elif kind == "PARAM" and fields[0] == "robot_frontlaser_offset":
                (lidar["mount_x"],) = _numbers(fields[1:2])
                continue
            else:
                continue
            if len(fields) < num_fields:
                raise ValueError(f"cut off, {len(fields)} of {num_fields} fields")
            times += _numbers([fields[-3]])
            odometry.append(_numbers(pose))
            if kind != "ODOM":
                scan_rows.append(len(times) - 1)
                scans.append(np.array(scan, dtype=np.float32))
                if len(scans[-1]) != len(scans[0]):
                    raise ValueError(f"{len(scans[-1])} beams where earlier scans have {len(scans[0])}")
                if np.isnan(scans[-1]).any():
                    raise ValueError(f"beam {int(np.isnan(scans[-1]).argmax())} is NaN")
        except (ValueError, IndexError) as error:
            raise ValueError(f"{path}, line {number}: bad {kind} line: {error}") from error
    if not scans:
        raise ValueError(f"{path}: holds no FLASER or ROBOTLASER1 lines")
    arrays = {"t": times, "odo": odometry, "idx": scan_rows, "ranges": scans}
    return {name: np.array(values) for name, values in arrays.items()} | lidar


def _lines(path: Path) -> Iterator[str]:
    opener = gzip.open if path.suffix == ".gz" else open
    try:
        with opener(path, "rt", encoding="ascii", errors="replace") as file:
            length = 0
            while line := file.readline(MAX_LINE):
                length += len(line)
                if len(line) == MAX_LINE or length > MAX_TEXT:
                    allowed = f"{MAX_LINE:,} characters in a line and {MAX_TEXT:,} in all are allowed"
                    raise ValueError(f"{path}: too long; at most {allowed}")
                yield line
    except (EOFError, gzip.BadGzipFile, zlib.error) as error:
        raise ValueError(f"{path}: damaged or cut off: {error}") from error


def _numbers(fields: list[str]) -> list[float]:
    values = [float(field) for field in fields]
    for field, value in zip(fields, values):
        if not math.isfinite(value):
            raise ValueError(f"{field} where a finite number is needed")
    return values


def read_archive(path: Path) -> dict[str, Any]:
    """Read the arrays of `load_log`, `off` added to `t`; ValueError if damaged, or one is missing or misshapen."""
    arrays: dict[str, Any] = {}
    name = ""
    try:
        with open_archive(path) as archive:
            if missing := _DIMENSIONS.keys() - set(archive.files):
                raise ValueError(f"lacks the arrays {sorted(missing)}")
            for name in (_DIMENSIONS | _OPTIONAL).keys() & set(archive.files):
                arrays[name] = archive[name]
    except PermissionError:
        raise
    except Exception as error:  # NumPy and zipfile raise many kinds; objects are scans with unequal numbers of beams
        said = " ".join(str(error).split())
        raise ValueError(f"{path}{f', array {name}' if name else ''}: {said}") from error
    for name, array in arrays.items():
        if not isinstance(array, np.ndarray):
            raise ValueError(f"{path}, array {name}: damaged")
        dimensions = (_DIMENSIONS | _OPTIONAL)[name]
        if array.ndim != dimensions or array.dtype.kind not in "iuf":
            raise ValueError(
                f"{path}, array {name}: numbers in {dimensions} dimensions are needed, got {array.dtype} {array.shape}"
            )
    if not np.isfinite(arrays["idx"]).all():
        raise ValueError(f"{path}, array idx: must be finite")
    if arrays["odo"].shape[1] != 3:
        raise ValueError(f"{path}, array odo: rows of x, y, heading are needed, got shape {arrays['odo'].shape}")
    return arrays | {"t": arrays["t"] + float(arrays.get("off", 0.0))}

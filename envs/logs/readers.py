"""Readers of logs in CARMEN text (.log, .clf, also gzipped) and NumPy archives (.npz)."""

import gzip
import math
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from lidarnaut.envs.files import open_archive
from lidarnaut.envs.geometry import Pose2D, wrap_angle

from .scans import FULL_TURN, LogContent, Scan

_DIMENSIONS = {"t": 1, "odo": 2, "idx": 1, "ranges": 2, "ang0": 0, "dang": 0, "maxr": 0}
_OPTIONAL = {"mount_x": 0, "off": 0}
SICK_MAX_RANGE = 80.0
"""Maximum range of SICK lasers [m], assumed for CARMEN's FLASER lines."""
SICK_STEPS = {180: 1.0, 181: 1.0, 360: 0.5, 361: 0.5, 400: 0.25, 401: 0.25}
"""Angle increment by number of beams of a FLASER line, as in CARMEN [deg]."""
FINEST_STEP = 0.25
"""Minimum angle increment of a SICK laser [deg]."""
SAME_MOUNT = 0.05
"""Maximum difference between laser poses on the robot within a log [m, rad]."""
MAX_LINE = 1_000_000
"""Maximum length of a line of a log [characters]."""
MAX_TEXT = 2**30
"""Maximum length of an unpacked log [characters]."""


def read_carmen(path: Path, field_of_view: float | None = None) -> LogContent:
    """Read the ODOM, FLASER and ROBOTLASER1 lines of a CARMEN log with one laser.

    FLASER lines lack angles. As in CARMEN, 180 or 181 beams have increments of 1 degree, 360 or 361 of 0.5, 400 or 401
    of 0.25; other scans cover 180 degrees, or `field_of_view` [rad]. The laser is `robot_frontlaser_offset` ahead of
    the base.

    Raises:
        ValueError: damaged line, truncated file, no scans, or several lasers.
    """
    times, odometry, notes, num_empty, offset = [], [], list[str](), 0, 0.0
    scans: dict[str, list[Scan]] = {"FLASER": [], "ROBOTLASER1": []}
    mounts: list[tuple[int, Pose2D]] = []
    for number, line in enumerate(_lines(path), start=1):
        kind, *fields = line.split() or [""]
        try:
            if kind == "PARAM" and fields[0] == "robot_frontlaser_offset":
                if offset != (values := _numbers(fields[1:2]))[0] and scans["FLASER"]:
                    raise ValueError(f"{fields[0]} is {values[0]:g}, earlier {offset:g}; split the log there")
                (offset,) = values
            if kind != "ODOM" and kind not in scans:
                continue
            readings, pose, laser, beams, num_fields = _parts(kind, fields, field_of_view)
            if len(fields) != num_fields:
                raise ValueError(f"{len(fields)} fields instead of {num_fields}: truncated, or wrong count")
            if laser:
                mounts.append((number, Pose2D(*_numbers(pose)).between(Pose2D(*_numbers(laser)))))
            times += _numbers([fields[-3]])
            odometry.append(_numbers(pose))
            if not readings:
                num_empty += kind != "ODOM"
                continue
            scan = Scan(np.array(readings, dtype=np.float32), *beams, row=len(times) - 1)
            _check(scan, scans[kind])
            scans[kind].append(scan)
        except (ValueError, IndexError, OverflowError) as error:
            raise ValueError(f"{path}, line {number}: bad {kind} line: {error}") from error
    if not any(scans.values()):
        raise ValueError(f"{path}: holds no FLASER or ROBOTLASER1 lines with beams")
    if num_empty:
        num_scans = num_empty + sum(map(len, scans.values()))
        notes.append(f"{num_empty} of {num_scans} scans are left out: they have no beams")
    if scans["ROBOTLASER1"]:
        if field_of_view is not None:
            reason = "is for FLASER lines; ROBOTLASER1 lines have angles"
            raise ValueError(f"{path}: field_of_view (--field-of-view) {reason}")
        if scans["FLASER"]:
            notes.append(f"{len(scans['FLASER'])} FLASER lines are left out: there are ROBOTLASER1 lines")
        mount = _find_mount(path, mounts)
        position = mount.x, mount.y, 0.0
        placed = [scan._replace(first=scan.first + mount.theta, position=position) for scan in scans["ROBOTLASER1"]]
    else:
        placed = [scan._replace(position=(offset, 0.0, 0.0)) for scan in scans["FLASER"]]
        if (count := len(placed[0].ranges)) not in SICK_STEPS and field_of_view is None:
            spread = "assuming 180 degrees, as in CARMEN; set field_of_view (--field-of-view) to change"
            notes.append(f"FLASER lines do not hold the angles of their {count} beams: {spread}")
    return LogContent(np.array(times), np.array(odometry), placed, notes)


def _parts(
    kind: str, fields: list[str], field_of_view: float | None
) -> tuple[list[str], list[str], list[str], tuple[float, float, float, float], int]:
    """Return readings, poses of base and laser, first angle, increment and range limits, and number of fields."""
    if kind == "ODOM":
        return [], fields[0:3], [], (0.0, 0.0, 0.0, 0.0), 9
    if kind == "FLASER":
        count = int(fields[0])
        first, step = _flaser_beams(count, field_of_view) if count else (0.0, 0.0)
        return fields[1 : 1 + count], fields[4 + count : 7 + count], [], (first, step, 0.0, SICK_MAX_RANGE), count + 10
    beams, count = (float(fields[1]), float(fields[3]), 0.0, float(fields[4])), int(fields[7])
    after = 9 + count + int(fields[8 + count])
    return fields[8 : 8 + count], fields[after + 3 : after + 6], fields[after : after + 3], beams, after + 14


def _find_mount(path: Path, mounts: list[tuple[int, Pose2D]]) -> Pose2D:
    poses = np.array([mount for _, mount in mounts])
    turns = wrap_angle(poses[:, 2] - poses[len(poses) // 2, 2])
    x, y, turn = np.median(np.column_stack([poses[:, :2], turns]), axis=0).tolist()
    median = Pose2D(x, y, float(wrap_angle(poses[len(poses) // 2, 2] + turn)))
    for number, mount in mounts:
        away = median.between(mount)
        if max(math.hypot(away.x, away.y), abs(away.theta)) > SAME_MOUNT:
            text = ", in other lines ".join("({:.3f}, {:.3f}, {:.3f})".format(*pose) for pose in (mount, median))
            raise ValueError(f"{path}, line {number}: poses of laser and robot do not agree: the mount is {text}")
    return median


def _flaser_beams(count: int, field_of_view: float | None) -> tuple[float, float]:
    gaps = max(count - 1, 1)
    if field_of_view is None and (known := SICK_STEPS.get(count)):
        # CARMEN's field of view: 100 degrees for 0.25, else 180.
        return math.radians(-50.0 if known == 0.25 else -90.0), math.radians(known)
    if field_of_view is None and 180.0 / gaps < FINEST_STEP - 1e-9:
        advice = "give field_of_view (--field-of-view), 4.712 rad for the 270 degrees of most lasers with 1081 beams"
        raise ValueError(f"{count} beams would be {180.0 / gaps:.3g} degrees apart over 180 degrees; {advice}")
    fov = math.pi if field_of_view is None else field_of_view
    return -fov / 2.0, fov / (count if fov > FULL_TURN else gaps)


def _check(scan: Scan, earlier: list[Scan]) -> None:
    if np.isnan(scan.ranges).any():
        raise ValueError(f"beam {int(np.isnan(scan.ranges).argmax())} is NaN")
    if not earlier:
        return
    first = earlier[0]
    if len(scan.ranges) != len(first.ranges):
        raise ValueError(f"{len(scan.ranges)} beams, earlier scans {len(first.ranges)}; split the log there")
    for name in ("first", "step", "range_max"):
        value, before = getattr(scan, name), getattr(first, name)
        if not abs(value - before) <= 1e-3 * max(abs(before), abs(first.step)):
            raise ValueError(f"laser configuration ({name}) is {value:g}, earlier {before:g}; split the log there")


def _lines(path: Path) -> Iterator[str]:
    opener = gzip.open if path.suffix == ".gz" else open
    try:
        with opener(path, "rt", encoding="utf-8-sig", errors="replace") as file:
            length = 0
            while line := file.readline(MAX_LINE):
                length += len(line)
                if len(line) == MAX_LINE or length > MAX_TEXT:
                    allowed = f"{MAX_LINE:,} characters in a line and {MAX_TEXT:,} in all are allowed"
                    raise ValueError(f"{path}: too long; at most {allowed}")
                yield line
    except (EOFError, gzip.BadGzipFile, zlib.error) as error:
        raise ValueError(f"{path}: damaged or truncated: {error}") from error


def _numbers(fields: list[str]) -> list[float]:
    values = [float(field) for field in fields]
    for field, value in zip(fields, values):
        if not math.isfinite(value):
            raise ValueError(f"expected a finite number, got {field}")
    return values


def read_archive(path: str | Path) -> LogContent:
    """Read a log from a NumPy archive (.npz); ValueError if an array is missing or invalid."""
    arrays: dict[str, Any] = {}
    with open_archive(path) as archive:
        if missing := _DIMENSIONS.keys() - set(archive.files):
            raise ValueError(f"lacks the arrays {sorted(missing)}")
        for name in (_DIMENSIONS | _OPTIONAL).keys() & set(archive.files):
            try:
                arrays[name] = archive[name]
            except Exception as error:
                raise ValueError(f"array {name}: {error}") from error
    for name, array in arrays.items():
        if not isinstance(array, np.ndarray):
            raise ValueError(f"{path}, array {name}: damaged")
        dimensions = (_DIMENSIONS | _OPTIONAL)[name]
        if array.ndim != dimensions or array.dtype.kind not in "iuf":
            given = f"{array.dtype} {array.shape}"
            raise ValueError(f"{path}, array {name}: must have numbers in {dimensions} dimensions, got {given}")
    if arrays["odo"].shape[1] != 3:
        raise ValueError(f"{path}, array odo: must have rows of x, y, heading, got shape {arrays['odo'].shape}")
    lengths = {name: len(arrays[name]) for name in ("t", "odo", "idx", "ranges")}
    if lengths["t"] != lengths["odo"] or lengths["idx"] != lengths["ranges"]:
        raise ValueError(f"{path}: numbers of times, poses and scans do not agree: {lengths}")
    if not np.isfinite(arrays["idx"]).all() or (arrays["idx"] != np.rint(arrays["idx"])).any():
        raise ValueError(f"{path}, array idx: must be finite integers")
    beams = float(arrays["ang0"]), float(arrays["dang"]), 0.0, float(arrays["maxr"])
    position = float(arrays.get("mount_x", 0.0)), 0.0, 0.0
    ranges = arrays["ranges"].astype(np.float32)
    scans = [Scan(row, *beams, position, k) for row, k in zip(ranges, arrays["idx"].astype(np.int64).tolist())]
    times = arrays["t"].astype(np.float64) + float(arrays.get("off", 0.0))
    return LogContent(times, arrays["odo"].astype(np.float64), scans, [])

"""Observation of recent scans, pooled to sectors."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces

from lidarnaut.envs.arguments import is_number, is_whole
from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry.pose import between, compose
from lidarnaut.envs.geometry.rows import write_row
from lidarnaut.envs.robot import Robot
from lidarnaut.envs.robot_rows import RobotRows
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.task import RowPart

NEARNESS = 0.5
"""Distance between footprint and obstacle that is encoded as 0.5 in the observation [m]; contact is encoded as 1."""
MAX_LAG = 1000
"""Maximum age of an observed scan [control periods]."""
SURFACE_STEP = 0.5
"""Maximum range difference between neighbouring sectors (groups of beams) on one surface [m]."""
MAX_FILL_SECTORS = 8
MOTION = 3


class Sectors(NamedTuple):
    """Geometry of a lidar's sectors (equal groups of beams).

    `x`, `y`, `yaw`: lidar pose, base frame. `first`: start of the first sector, lidar frame [rad]. `per_radian`:
    sectors per radian. `radius`: footprint radius [m]. `directions`: unit vectors to the sector centres, shape (2, n),
    float32. `beams`: first beam of each sector, and the number of beams, int64.
    """

    x: float
    y: float
    yaw: float
    first: float
    per_radian: float
    radius: float
    directions: np.ndarray
    beams: np.ndarray

    @classmethod
    def of(cls, robot: RobotParams, num_sectors: int) -> "Sectors":
        lidar = robot.lidar
        beams = lidar.num_beams / num_sectors
        first = lidar.angle_min - 0.5 * lidar.angle_increment
        middles = first + (np.arange(num_sectors) + 0.5) * beams * lidar.angle_increment
        directions = np.array([np.cos(middles), np.sin(middles)], dtype=np.float32)
        per_radian = 1.0 / (beams * lidar.angle_increment)
        ends = np.arange(num_sectors + 1) * lidar.num_beams // num_sectors
        return cls(lidar.mount.x, lidar.mount.y, lidar.mount.yaw, first, per_radian, robot.radius, directions, ends)


@njit(cache=True, error_model="numpy")
def pool_scan(ranges, beams, sectors):
    """Write the minimum range of each group of beams to `sectors` [m]: inf without a return, 0 without a valid beam."""
    for k in range(sectors.shape[0]):
        nearest, is_known = np.float32(np.inf), False
        for i in range(beams[k], beams[k + 1]):
            is_known |= ranges[i] <= nearest
            nearest = ranges[i] if ranges[i] < nearest else nearest
        sectors[k] = nearest if is_known else np.float32(0.0)


@njit(cache=True, error_model="numpy", inline="always")
def _angle(x, y):
    """Return the angle of vector (x, y) in [0, 2 pi], to 1e-5 rad (Abramowitz and Stegun, 1964, equation 4.4.49)."""
    a, b = abs(x), abs(y)
    t = min(a, b) / max(a, b, np.float32(1e-9))
    t2 = t * t
    u = np.float32(-0.0851330) + t2 * np.float32(0.0208351)
    u = np.float32(0.9998660) + t2 * (np.float32(-0.3302995) + t2 * (np.float32(0.1801410) + t2 * u))
    angle = t * u
    angle = np.float32(0.5 * math.pi) - angle if b > a else angle
    angle = np.float32(math.pi) - angle if x < 0 else angle
    return np.float32(2.0 * math.pi) - angle if y < 0 else angle


@njit(cache=True, error_model="numpy")
def shift_sectors(ranges, motion, sectors, seen, polar):
    """Transform ranges of a past scan to the current base pose; write the minimum range per sector to `seen` [m].

    `ranges`: range per sector (group of beams) of the past scan. `motion`: base motion since that scan. `seen`:
    initially inf. `polar`: scratch. Gaps between sectors on one surface are filled by interpolation.
    """
    x, y, theta = compose(motion[0], motion[1], motion[2], sectors.x, sectors.y, sectors.yaw)
    x, y, theta = between(sectors.x, sectors.y, sectors.yaw, x, y, theta)
    x, y, turn = np.float32(x), np.float32(y), np.float32((theta + sectors.first) % (2.0 * math.pi))
    count, scale = ranges.shape[0], np.float32(sectors.per_radian)
    whole = np.float32(2.0 * math.pi) * scale
    for k in range(count):
        r = ranges[k] if ranges[k] < np.inf else np.float32(1e6)
        dx, dy = r * sectors.directions[0, k] - x, r * sectors.directions[1, k] - y
        along = (_angle(dx, dy) - turn) * scale
        polar[0, k], polar[1, k] = math.sqrt(dx * dx + dy * dy), along if along >= 0 else along + whole
    last = count - 1
    for k in range(count):
        r, along = polar[0, k], polar[1, k]
        steps, change_r, change = 1, np.float32(0.0), np.float32(0.0)
        if ranges[last] < np.inf and ranges[k] < np.inf and abs(ranges[last] - ranges[k]) < SURFACE_STEP:
            change = polar[1, last] - along
            change -= whole * np.float32(round(change / whole))
            if abs(change) < MAX_FILL_SECTORS:
                steps = max(1, int(abs(change) + 0.9))
                change_r, change = (polar[0, last] - r) / steps, change / steps
        for step in range(steps):
            sector = int(along + step * change)
            sector -= count * (sector >= count and whole <= count + 0.5)
            if 0 <= sector < count:
                seen[sector] = min(seen[sector], r + step * change_r)
        last = k


@njit(cache=True, error_model="numpy")
def write_history(rows, ranges, memory, active, out, lags, sectors, compensates):
    """Store each robot's scan; write its recent scans to `out`, shape (n, len(lags) * num_sectors), float32.

    `memory`: stored control periods of each robot: odometry motion, and minimum range per sector (group of beams).
    `lags`: ages of the written scans, increasing [control periods]. `active`: mask of robots. `sectors`: see `Sectors`.
    """
    sectors = Sectors(*sectors)
    count = sectors.directions.shape[1]
    seen, polar = np.empty(count, dtype=np.float32), np.empty((2, count), dtype=np.float32)
    near, radius = np.float32(NEARNESS), np.float32(sectors.radius)
    for i in range(active.shape[0]):
        if not active[i]:
            continue
        ring = memory[i].reshape(-1, MOTION + count)
        steps, num_slots = int(rows[i].steps), ring.shape[0]
        newest = ring[steps % num_slots]
        write_row(newest, rows[i].odometry)
        pool_scan(ranges[i], sectors.beams, newest[MOTION:])
        motion, age = (0.0, 0.0, 0.0), 0
        for j in range(lags.shape[0]):
            while compensates and age < lags[j]:
                step = ring[(steps - age) % num_slots]
                motion = compose(step[0], step[1], step[2], motion[0], motion[1], motion[2])
                age += 1
            past = ring[(steps - lags[j]) % num_slots, MOTION:]
            if age > 0:
                seen[:] = np.inf
                shift_sectors(past, motion, sectors, seen, polar)
            else:
                write_row(seen, past)
            for k in range(count):
                shown = near / (max(seen[k] - radius, np.float32(0.0)) + near)
                is_seen = seen[k] < np.inf or age == 0
                out[i, j * count + k] = shown if is_seen else out[i, k]


class ScanHistory(RowPart):
    """Observation of recent scans, newest first: `Box(0, 1, (len(lags) * num_sectors,), float32)`.

    Values are encoded minimum ranges in equal sectors (groups of beams). A range r is encoded as 0.5 m / (max(r -
    footprint radius, 0) + 0.5 m): 1 at the footprint or without a valid beam, 0 without a return. Odometry transforms
    past scans to the current pose, so that moving obstacles are visible. Missing sectors take the newest values. Call
    `write` after every control period.
    """

    def __init__(self, lags: Sequence[float] = (0.0, 0.2, 0.4), num_sectors: int = 90, compensate: bool = True) -> None:
        """Set the increasing ages of scans [s], the number of sectors, and whether odometry transforms past scans.

        Raises:
            ValueError: `lags` negative or not increasing, or `num_sectors` not positive.
        """
        ages = list(lags) if isinstance(lags, Sequence) else []
        if not ages or not all(map(is_number, ages)) or ages[0] < 0 or ages != sorted(set(ages)):
            raise ValueError(f"scan_history needs increasing lags of at least 0 s, got {lags!r}")
        if not (is_whole(num_sectors) and num_sectors >= 1):
            raise ValueError(f"scan_history needs a positive number of sectors, got {num_sectors!r}")
        self._ages, self._num_sectors, self._compensates = tuple(map(float, ages)), int(num_sectors), bool(compensate)
        self._memory = "scan_history", self._ages, self._num_sectors
        self._shown: tuple[np.ndarray, tuple[Any, ...], bool]

    def space(self, robot: RobotParams) -> spaces.Box:
        if self._num_sectors > robot.lidar.num_beams:
            beams = f"the {robot.lidar.num_beams} beams of robot {robot.name!r}"
            raise ValueError(f"scan_history cannot make {self._num_sectors} sectors of {beams}")
        return spaces.Box(0.0, 1.0, (len(self._ages) * self._num_sectors,), np.float32)

    def reset(self, robot: Robot) -> None:
        lags = np.array([round(age / robot.control_period) for age in self._ages])
        if lags[-1] > MAX_LAG:
            raise ValueError(f"lags of scan_history must be at most {MAX_LAG} control periods, got {self._ages} s")
        sectors, size = Sectors.of(robot.params, self._num_sectors), MOTION + self._num_sectors
        self._shown = lags, tuple(sectors), self._compensates  # Numba takes longer to recognise named tuples
        ring = robot.remember(self._memory, (lags[-1] + 1) * size, np.float32).reshape(-1, size)
        ring[0, :MOTION] = 0.0
        pool_scan(robot.ranges, sectors.beams, ring[0, MOTION:])
        ring[:] = ring[0]

    def _write(self, rows: RobotRows, out: np.ndarray) -> None:
        write_history(rows.numbers, rows.ranges, rows.memory[self._memory], rows.active, out, *self._shown)

"""What a policy sees: the scan, two egocentric crops of the believed map, and the robot's own motion."""

import math

import numpy as np
from gymnasium import spaces
from numba import njit

from envs.geometry import Pose2D
from envs.robots import RobotParams
from envs.simulation import Reading, Twist
from envs.slam import Belief

CROP_SIZE = 40
"""Side of a map crop [pixels]."""
NEAR_PIXEL = 0.2
"""Side of a pixel of `map_near` [m]."""
FAR_PIXEL = 0.8
"""Side of a pixel of `map_far` [m]."""
SAMPLES = 3
"""Map look-ups per pixel along each axis."""
TRAIL_SPACING = 0.1
"""Distance between remembered positions of the trail [m]."""
OCCUPIED_FROM = 50
"""Least occupancy at which a cell counts as occupied [percent]."""


def observation_space(robot: RobotParams) -> spaces.Dict:
    """Return the space of `observe`'s result for a robot."""
    crop = spaces.Box(0, 255, (3, CROP_SIZE, CROP_SIZE), np.uint8)
    return spaces.Dict(
        {
            "scan": spaces.Box(0.0, 1.0, (robot.lidar.num_beams,), np.float32),
            "map_near": crop,
            "map_far": spaces.Box(0, 255, crop.shape, np.uint8),
            "motion": spaces.Box(-1.0, 1.0, (6,), np.float32),
        }
    )


@njit(cache=True, error_model="numpy")
def crop_map(data, origin_x, origin_y, resolution, x, y, theta, pixel, trail, crop):
    """Look at the map from the robot: axis 1 of `crop` points forward, axis 2 to the left, the robot in the middle.

    Args:
        data: shape (height, width), int8, occupancy.
        origin_x: x of the outer corner of cell (0, 0), map frame [m].
        origin_y: y of the same [m].
        resolution: side of a map cell [m].
        x: believed position of the robot, map frame [m].
        y: the same [m].
        theta: believed heading [rad].
        pixel: side of a crop pixel [m].
        trail: shape (n, 2), float64, past positions, map frame [m].
        crop: shape (3, size, size), uint8, written: 255 where a look-up is occupied; share of look-ups that are free,
            times 255; 255 where the robot has been.
    """
    height, width = data.shape
    size = crop.shape[1]
    c, s = math.cos(theta), math.sin(theta)
    # Look-ups are equally spaced over the whole crop, so one affine walk gives all their positions in cells.
    step = np.float32(pixel / SAMPLES / resolution)
    first = np.float32((-0.5 * size + 0.5 / SAMPLES) * pixel / resolution)
    cos, sin = np.float32(c), np.float32(s)
    base_col = np.float32((x - origin_x) / resolution)
    base_row = np.float32((y - origin_y) / resolution)
    for i in range(size):
        for j in range(size):
            free = 0
            occupied = 0
            for a in range(SAMPLES):
                u = first + np.float32(i * SAMPLES + a) * step
                for b in range(SAMPLES):
                    v = first + np.float32(j * SAMPLES + b) * step
                    col_f = base_col + cos * u - sin * v
                    row_f = base_row + sin * u + cos * v
                    if col_f >= 0 and row_f >= 0 and col_f < width and row_f < height:
                        value = data[np.uint32(row_f), np.uint32(col_f)]
                        free += 0 <= value < OCCUPIED_FROM
                        occupied += value >= OCCUPIED_FROM
            crop[0, i, j] = 255 if occupied else 0
            crop[1, i, j] = 255 * free // (SAMPLES * SAMPLES)
            crop[2, i, j] = 0
    for k in range(trail.shape[0]):
        dx, dy = trail[k, 0] - x, trail[k, 1] - y
        i = math.floor((c * dx + s * dy) / pixel + 0.5 * size)
        j = math.floor((c * dy - s * dx) / pixel + 0.5 * size)
        if 0 <= i < size and 0 <= j < size:
            crop[2, i, j] = 255


@njit(cache=True, error_model="numpy")
def is_apart(positions, length, x, y):
    """Tell whether (x, y) lies `TRAIL_SPACING` or more from the last of `length` positions, shape (>= length, 2)."""
    return length == 0 or math.hypot(x - positions[length - 1, 0], y - positions[length - 1, 1]) >= TRAIL_SPACING


@njit(cache=True, error_model="numpy")
def scale_scan(ranges, range_max, scan):
    """Write to `scan` the ranges over the greatest: 1 without a return, 0 for lost beams; both shape (n,), float32."""
    scale = np.float32(1.0 / range_max)
    for k in range(ranges.shape[0]):
        r = ranges[k]
        scan[k] = np.float32(0.0) if math.isnan(r) else min(r * scale, np.float32(1.0))


@njit(cache=True, error_model="numpy")
def fill_motion(v, w, max_v, max_w, action_v, action_w, bumper, elapsed, motion):
    """Write the robot's own motion to `motion`, shape (6,), float32; see `ExploreEnv`."""
    motion[0] = min(max(v / max_v, -1.0), 1.0)
    motion[1] = min(max(w / max_w, -1.0), 1.0)
    motion[2] = action_v
    motion[3] = action_w
    motion[4] = 1.0 if bumper else 0.0
    motion[5] = min(elapsed, 1.0)


class Trail:
    """Positions that the robot believes to have passed, `TRAIL_SPACING` apart, in the map frame."""

    def __init__(self) -> None:
        self.buffer = np.empty((256, 2))
        """Shape (room, 2), float64: the positions, and room for more."""
        self._length = 0

    def append(self, pose: Pose2D) -> None:
        """Remember the position if it is far enough from the last one remembered."""
        if not is_apart(self.buffer, self._length, pose.x, pose.y):
            return
        if self._length == len(self.buffer):
            self.enlarge()
        self.buffer[self._length] = pose.x, pose.y
        self._length += 1

    def enlarge(self) -> None:
        """Double the room for positions."""
        self.buffer = np.concatenate([self.buffer, np.empty_like(self.buffer)])

    @property
    def positions(self) -> np.ndarray:
        """Shape (n, 2), float64 [m]; a view."""
        return self.buffer[: self._length]


def observe(
    robot: RobotParams,
    reading: Reading,
    belief: Belief,
    trail: Trail,
    twist: Twist,
    last_action: np.ndarray,
    elapsed: float,
) -> dict[str, np.ndarray]:
    """Compose an observation in fresh arrays; see `ExploreEnv` for what each part means.

    Args:
        robot: scales ranges and velocities.
        reading: what the sensors say.
        belief: what the SLAM believes.
        trail: where the robot believes to have been.
        twist: velocity by wheel odometry.
        last_action: shape (2,), the action that led here.
        elapsed: share of the time limit that has passed.
    """
    scan = np.empty_like(reading.ranges)
    scale_scan(reading.ranges, robot.lidar.range_max, scan)
    grid = belief.grid
    crops = []
    for pixel in (NEAR_PIXEL, FAR_PIXEL):
        crop = np.empty((3, CROP_SIZE, CROP_SIZE), dtype=np.uint8)
        crop_map(grid.data, *grid.origin, grid.resolution, *belief.pose, pixel, trail.positions, crop)
        crops.append(crop)
    motion = np.empty(6, dtype=np.float32)
    limits, action = (robot.max_v, robot.max_w), (last_action[0], last_action[1])
    fill_motion(*twist, *limits, *action, reading.bumper, elapsed, motion)
    return {"scan": scan, "map_near": crops[0], "map_far": crops[1], "motion": motion}

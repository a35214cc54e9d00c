"""What a policy sees: the scan, two egocentric crops of the believed map, and the robot's own motion."""

import math

import numpy as np
from gymnasium import spaces
from numba import njit

from envs.geometry import Pose2D
from envs.map_pyramid import CROP_SIZE, MapPyramid
from envs.robots import RobotParams
from envs.simulation import Reading, Twist

TRAIL_SPACING = 0.1
"""Distance between remembered positions of the trail [m]."""


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

    def append(self, pose: Pose2D) -> bool:
        """Remember the position if it is far enough from the last one remembered; return whether it was."""
        if not is_apart(self.buffer, self._length, pose.x, pose.y):
            return False
        if self._length == len(self.buffer):
            self.enlarge()
        self.buffer[self._length] = pose.x, pose.y
        self._length += 1
        return True

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
    pose: Pose2D,
    pyramid: MapPyramid,
    twist: Twist,
    last_action: np.ndarray,
    elapsed: float,
) -> dict[str, np.ndarray]:
    """Compose an observation in fresh arrays; see `ExploreEnv` for what each part means.

    Args:
        robot: scales ranges and velocities.
        reading: what the sensors say.
        pose: where the robot believes to be, map frame.
        pyramid: the map that it believes in.
        twist: velocity by wheel odometry.
        last_action: shape (2,), the action that led here.
        elapsed: share of the time limit that has passed.
    """
    scan = np.empty_like(reading.ranges)
    scale_scan(reading.ranges, robot.lidar.range_max, scan)
    near = np.empty((3, CROP_SIZE, CROP_SIZE), dtype=np.uint8)
    far = np.empty_like(near)
    pyramid.crop(*pose, near, far)
    motion = np.empty(6, dtype=np.float32)
    limits, action = (robot.max_v, robot.max_w), (last_action[0], last_action[1])
    fill_motion(*twist, *limits, *action, reading.bumper, elapsed, motion)
    return {"scan": scan, "map_near": near, "map_far": far, "motion": motion}

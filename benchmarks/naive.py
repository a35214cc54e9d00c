"""The usual design of an exploration environment, as the reference of `benchmarks.throughput`.

PyBullet with a body per box at its usual 240 Hz, the lidar by `rayTestBatch`, TinySLAM and everything else in NumPy. It
does the same job as `envs.explore` with the same robot, params and rewards, and nothing in it is slower than it has to
be; the observation is the simpler one of most such environments: scan, one crop of the map, motion.
"""

import math
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from benchmarks.naive_physics import NaivePhysics
from benchmarks.naive_slam import NaiveSlam
from benchmarks.speed.halls import Hall
from envs.estimation.motion import wheel_motion
from envs.geometry import OccupancyGrid, Pose2D
from envs.robots import RobotParams
from envs.slam import load_params
from envs.tasks.rewards import RewardWeights
from envs.worlds import ExplorableArea, explorable_area

CROP_SIZE = 64
"""Side of the map crop [pixels]."""
PIXEL = 0.125
"""Side of a pixel of the map crop [m]."""
OCCUPIED_FROM = 0.5
"""Least occupancy at which a cell counts as occupied."""
QUARTERS = np.array([[0.25, 0.25], [0.75, 0.25], [0.25, 0.75], [0.75, 0.75]])
"""Points of a map cell that are looked up in the ground truth; see `envs.tasks.coverage.mark_known`."""


def crop_map(values: np.ndarray, counts: np.ndarray, x: float, y: float, theta: float, grid: np.ndarray) -> np.ndarray:
    """Look at the map from the robot, whose pose is given from the map's corner [cells, rad].

    Occupancies and their counts, 0 where nothing is known, have shape (height, width); `grid` says where the pixels
    lie, forward and left of the robot [cells], shape (2, size, size).

    Returns:
        Shape (2, size, size), uint8: 255 where occupied, and where free.
    """
    c, s = math.cos(theta), math.sin(theta)
    cols = np.floor(x + c * grid[0] - s * grid[1]).astype(np.int64)
    rows = np.floor(y + s * grid[0] + c * grid[1]).astype(np.int64)
    height, width = values.shape
    inside = (rows >= 0) & (rows < height) & (cols >= 0) & (cols < width)
    rows[~inside] = cols[~inside] = 0
    known = inside & (counts[rows, cols] > 0)
    occupied = values[rows, cols] >= OCCUPIED_FROM
    return np.stack([known & occupied, known & ~occupied]).astype(np.uint8) * np.uint8(255)


def count_new(cells: np.ndarray, belief: OccupancyGrid, start: Pose2D, area: ExplorableArea, seen: np.ndarray) -> int:
    """Mark in `seen` (bool) the explorable true cells under newly known map cells; return how many were new.

    `cells` are (row, column) of map cells, shape (k, 2), and `belief` tells where they lie in the map frame, whose
    origin has the pose `start` in the world frame.
    """
    corners = cells[:, None, ::-1] + QUARTERS
    points = start.transform((corners * belief.resolution + belief.origin).reshape(-1, 2))
    true_cells = area.walls.cells(points)
    rows, cols = true_cells[area.walls.contains(true_cells)].T
    new = area.explorable[rows, cols] & ~seen[rows, cols]
    indices = np.unique(rows[new] * seen.shape[1] + cols[new])
    seen.ravel()[indices] = True
    return len(indices)


class NaiveExploreEnv(gymnasium.Env[dict[str, np.ndarray], np.ndarray]):
    """Explore a hall; actions, rewards and end as in `envs.explore.ExploreEnv`.

    Observations: `scan` (ranges over the greatest), `map` (occupied and free, 64 x 64 pixels of 0.125 m around the
    robot), `motion` (forward speed and yaw rate by odometry over the limits, last action, bumper).
    """

    def __init__(self, hall: Hall, robot: RobotParams, slam: str = "tinyslam", control_hz: float = 10.0) -> None:
        """Build the hall; `slam` is "tinyslam", or "truth" to map at the true pose."""
        self._hall, self._robot, self._period = hall, robot, 1.0 / control_hz
        self._uses_truth = slam == "truth"
        params = replace(load_params("default"), odometry_noise=robot.odometry.noise)
        self.slam = NaiveSlam(robot.lidar, params, match_scans=slam == "tinyslam")
        self._physics = NaivePhysics(hall, robot, self._period)
        self._weights = RewardWeights()
        pixels = (np.arange(CROP_SIZE) + 0.5 - CROP_SIZE / 2) * PIXEL / self.slam.resolution
        self._grid = np.stack(np.meshgrid(pixels, pixels, indexing="ij"))
        (height, width), resolution = self.slam.shape, self.slam.resolution
        corner = (-(width // 2) * resolution, -(height // 2) * resolution)
        self._cells = OccupancyGrid(np.empty((0, 0), dtype=np.int8), resolution, corner)
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.observation_space: spaces.Space[Any] = spaces.Dict(
            {
                "scan": spaces.Box(0.0, 1.0, (robot.lidar.num_beams,), np.float32),
                "map": spaces.Box(0, 255, (2, CROP_SIZE, CROP_SIZE), np.uint8),
                "motion": spaces.Box(-1.0, 1.0, (5,), np.float32),
            }
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Put the robot into the middle of the hall."""
        super().reset(seed=seed)
        self.area = explorable_area(self._hall.world, self._robot, self.slam.resolution)
        self.time_limit = self.area.usual_time_limit(self._robot.max_v)
        self._num_explorable = np.count_nonzero(self.area.explorable)
        self.start = self._hall.world.spawns[0]
        self._physics.reset(self.start)
        self._ticks = self._physics.ticks()
        self.pose = self._physics.pose()
        self.slam.reset(self.np_random)
        self._ranges = self._physics.scan(self.pose, self.np_random)
        self._seen = np.zeros_like(self.area.explorable)
        self._num_seen = self._gain(self.slam.update(self._ranges, Pose2D(0.0, 0.0, 0.0)))
        self._motion = Pose2D(0.0, 0.0, 0.0)
        self._steps = 0
        return self._observe(np.zeros(2), False), self._info()

    def step(self, action: np.ndarray) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Drive for one control period."""
        v, w = (float(part) for part in action)
        touching = self._physics.step(v * self._robot.max_v, w * self._robot.max_w)
        self._steps += 1
        before, self.pose = self.pose, self._physics.pose()
        self._ranges = self._physics.scan(self.pose, self.np_random)
        (left_before, right_before), (left, right) = self._ticks, self._physics.ticks()
        self._ticks = left, right
        wheels = self._robot.odometry
        motion = wheel_motion(left - left_before, right - right_before, wheels.metres_per_tick, wheels.track)
        self._motion = Pose2D(*motion)
        motion = before.between(self.pose) if self._uses_truth else self._motion
        gained = self._gain(self.slam.update(self._ranges, motion))
        self._num_seen += gained
        weights = self._weights
        terminated = bool(self._num_seen / self._num_explorable >= 0.99)
        reward = weights.explored * gained * self.area.walls.resolution**2 + weights.time * self._period
        reward += weights.collision * self._period * touching + weights.completed * terminated
        truncated = not terminated and self._steps * self._period >= self.time_limit
        return self._observe(action, touching), float(reward), terminated, truncated, self._info()

    def close(self) -> None:
        """Disconnect from PyBullet."""
        self._physics.close()

    def _gain(self, new_cells: np.ndarray) -> int:
        return count_new(new_cells, self._cells, self.start, self.area, self._seen) if len(new_cells) else 0

    def _observe(self, action: np.ndarray, touching: bool) -> dict[str, np.ndarray]:
        scan = np.minimum(np.nan_to_num(self._ranges, nan=0.0, posinf=np.inf) / self._robot.lidar.range_max, 1.0)
        cells = self.slam.to_cells(self.slam.pose.x, self.slam.pose.y)
        crop = crop_map(self.slam.values, self.slam.counts, *cells, self.slam.pose.theta, self._grid)
        v = self._motion.x / self._period / self._robot.max_v
        w = self._motion.theta / self._period / self._robot.max_w
        motion = np.clip([v, w, *action, touching], -1.0, 1.0).astype(np.float32)
        return {"scan": scan.astype(np.float32), "map": crop, "motion": motion}

    def _info(self) -> dict[str, Any]:
        error = self.start.compose(self.slam.pose).between(self.pose)
        return {
            "explored_fraction": self._num_seen / self._num_explorable,
            "pose_error": np.array([math.hypot(error.x, error.y), abs(error.theta)]),
            "time": self._steps * self._period,
        }

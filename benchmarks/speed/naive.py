"""Reference implementation of exploration with PyBullet (240 Hz, one body per box) and NumPy.

Robot, parameters and rewards equal those of `lidarnaut/Explore-v0`; observations are simpler.
"""

import math
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from lidarnaut.benchmarks.speed.halls import Hall
from lidarnaut.benchmarks.speed.naive_slam import NaiveSlam
from lidarnaut.envs.estimation import ORIGIN
from lidarnaut.envs.estimation.motion import wheel_motion
from lidarnaut.envs.geometry import OccupancyGrid, Pose2D
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation.bullet_robot import CHASSIS_LINK, WHEEL_LINKS, build_robot
from lidarnaut.envs.simulation.bullet_world import GROUND, ROLLING, BulletClient
from lidarnaut.envs.slam import load_params
from lidarnaut.envs.tasks.explore import Explore
from lidarnaut.envs.worlds import explorable_area

PHYSICS_HZ = 240
"""Physics steps per second [1/s], PyBullet's default."""
CROP_SIZE, PIXEL = 64, 0.125
"""Side of the square map image in observations [pixels], and of a pixel [m]."""
QUARTERS = np.array([[0.25, 0.25], [0.75, 0.25], [0.25, 0.75], [0.75, 0.75]])


class NaivePhysics:
    """PyBullet simulation of a robot in a hall, with one static body per box and cylinder."""

    def __init__(self, hall: Hall, robot: RobotParams, period: float) -> None:
        self._robot, self._period, height = robot, period, hall.world.height
        self._bullet = bullet = BulletClient()
        self.close = bullet.close
        bullet.setGravity(0.0, 0.0, -9.81)
        bullet.setTimeStep(1.0 / PHYSICS_HZ)
        plane = bullet.createMultiBody(0.0, bullet.createCollisionShape(bullet.GEOM_PLANE))
        bullet.setCollisionFilterGroupMask(plane, -1, GROUND, ROLLING)
        for x, y, *sides, yaw in hall.boxes:
            half_extents = [0.5 * side for side in (*sides, height)]
            shape = bullet.createCollisionShape(bullet.GEOM_BOX, halfExtents=half_extents)
            turned = bullet.getQuaternionFromEuler([0.0, 0.0, yaw])
            bullet.createMultiBody(0.0, shape, -1, [x, y, 0.5 * height], turned)
        for x, y, radius in hall.world.circles.tolist():
            shape = bullet.createCollisionShape(bullet.GEOM_CYLINDER, radius=radius, height=height)
            bullet.createMultiBody(0.0, shape, -1, [x, y, 0.5 * height])
        self._body = build_robot(bullet, robot)

    def reset(self, pose: Pose2D) -> None:
        orientation = self._bullet.getQuaternionFromEuler([0.0, 0.0, pose.theta])
        position = [pose.x, pose.y, self._robot.drive.wheel_radius]
        self._bullet.resetBasePositionAndOrientation(self._body, position, orientation)
        self._bullet.resetBaseVelocity(self._body, [0.0] * 3, [0.0] * 3)
        for wheel in WHEEL_LINKS:
            self._bullet.resetJointState(self._body, wheel, 0.0, 0.0)
        self._v = self._w = 0.0

    def step(self, v: float, w: float) -> bool:
        """Drive at `v` [m/s] and `w` [rad/s] for one control period; return True on contact."""
        robot, wheels = self._robot, self._robot.odometry
        change_v, change_w = robot.max_acc_v * self._period, robot.max_acc_w * self._period
        self._v += min(max(v - self._v, -change_v), change_v)
        self._w += min(max(w - self._w, -change_w), change_w)
        aside = 0.5 * self._w * wheels.track
        speeds = [(self._v - aside) / wheels.wheel_radius, (self._v + aside) / wheels.wheel_radius]
        self._bullet.setJointMotorControlArray(
            self._body, WHEEL_LINKS, self._bullet.VELOCITY_CONTROL,
            targetVelocities=speeds, forces=[robot.drive.max_torque] * 2,
        )  # fmt: skip
        for _ in range(round(PHYSICS_HZ * self._period)):
            self._bullet.stepSimulation()
        return len(self._bullet.getContactPoints(self._body, linkIndexA=CHASSIS_LINK)) > 0

    def pose(self) -> Pose2D:
        (x, y, _), orientation = self._bullet.getBasePositionAndOrientation(self._body)
        return Pose2D(x, y, self._bullet.getEulerFromQuaternion(orientation)[2])

    def ticks(self) -> tuple[int, ...]:
        per_radian = self._robot.odometry.ticks_per_rev / (2.0 * math.pi)
        return tuple(
            math.floor(state[0] * per_radian) for state in self._bullet.getJointStates(self._body, WHEEL_LINKS)
        )

    def scan(self, pose: Pose2D, rng: np.random.Generator) -> np.ndarray:
        """Return noisy lidar ranges at a robot pose: shape (num_beams,), float32 [m]; NaN too near, inf too far."""
        lidar = self._robot.lidar
        sensor = pose.compose(Pose2D(lidar.mount.x, lidar.mount.y, lidar.mount.yaw))
        angles = sensor.theta + lidar.angles
        starts = np.tile([sensor.x, sensor.y, lidar.mount.z], (lidar.num_beams, 1))
        ends = starts.copy()
        ends[:, :2] += lidar.range_max * np.column_stack([np.cos(angles), np.sin(angles)])
        fractions = np.array([hit[2] for hit in self._bullet.rayTestBatch(starts, ends)])
        exact = fractions * lidar.range_max
        measured = exact + lidar.noise_std * rng.standard_normal(exact.shape)
        if lidar.resolution > 0.0:
            measured = lidar.resolution * np.floor(measured / lidar.resolution + 0.5)
        measured[(exact < lidar.range_min) | (measured < lidar.range_min)] = np.nan
        measured[(fractions >= 1.0) | (measured > lidar.range_max)] = np.inf
        return measured.astype(np.float32)


class NaiveExploreEnv(gymnasium.Env[dict[str, np.ndarray], np.ndarray]):
    """Exploration of a hall with the actions, rewards and end conditions of `lidarnaut/Explore-v0`.

    Observations: `scan` (ranges divided by the maximum range), `map` (occupied and free, robot-centred), `motion`
    (odometry twist, last action, contact).
    """

    def __init__(self, hall: Hall, robot: RobotParams, slam: str = "tinyslam", control_hz: float = 10.0) -> None:
        self._robot, self._period, self._uses_truth = robot, 1.0 / control_hz, slam == "truth"
        params = replace(load_params("default"), odometry_noise=robot.odometry.noise)
        self.slam = NaiveSlam(robot.lidar, params, match_scans=slam == "tinyslam")
        self._physics = NaivePhysics(hall, robot, self._period)
        self._area, self._start = explorable_area(hall.world, robot, params.resolution), hall.world.spawns[0]
        self.time_limit = self._area.usual_time_limit(robot.max_v)
        pixels = (np.arange(CROP_SIZE) + 0.5 - CROP_SIZE / 2) * PIXEL / params.resolution
        self._pixels = np.stack(np.meshgrid(pixels, pixels, indexing="ij"))  # forward and left [cells]
        corner = (-(self.slam.shape[1] // 2) * params.resolution, -(self.slam.shape[0] // 2) * params.resolution)
        self._cells = OccupancyGrid(np.empty((0, 0), dtype=np.int8), params.resolution, corner)
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.observation_space: spaces.Space[Any] = spaces.Dict(
            scan=spaces.Box(0.0, 1.0, (robot.lidar.num_beams,), np.float32),
            map=spaces.Box(0, 255, (2, CROP_SIZE, CROP_SIZE), np.uint8),
            motion=spaces.Box(-1.0, 1.0, (5,), np.float32),
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        super().reset(seed=seed)
        self._physics.reset(self._start)
        self.slam.reset(self.np_random)
        self._ticks, self._pose, self._steps = self._physics.ticks(), self._physics.pose(), 0
        self._seen = np.zeros_like(self._area.explorable)
        return self._observe(ORIGIN, ORIGIN, np.zeros(2), False)[1:]

    def step(self, action: np.ndarray) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        touching = self._physics.step(float(action[0]) * self._robot.max_v, float(action[1]) * self._robot.max_w)
        self._steps += 1
        before, self._pose = self._pose, self._physics.pose()
        (left_before, right_before), (left, right) = self._ticks, self._physics.ticks()
        self._ticks, wheels = (left, right), self._robot.odometry
        odometry = Pose2D(*wheel_motion(left - left_before, right - right_before, wheels.metres_per_tick, wheels.track))
        motion = before.between(self._pose) if self._uses_truth else odometry
        gained, observation, info = self._observe(motion, odometry, action, touching)
        weights, terminated = Explore.weights, bool(info["explored_fraction"] >= 0.99)
        reward = weights["explored"] * gained * self._area.walls.resolution**2 + weights["time"] * self._period
        reward += weights["collision"] * self._period * touching + weights["completed"] * terminated
        return observation, float(reward), terminated, not terminated and info["time"] >= self.time_limit, info

    def close(self) -> None:
        self._physics.close()

    def _observe(
        self, motion: Pose2D, odometry: Pose2D, action: np.ndarray, touching: bool
    ) -> tuple[int, dict[str, np.ndarray], dict[str, Any]]:
        ranges, robot = self._physics.scan(self._pose, self.np_random), self._robot
        new_cells = self.slam.update(ranges, motion)
        gained = self._gain(new_cells) if len(new_cells) else 0
        scan = np.minimum(np.nan_to_num(ranges, nan=0.0, posinf=np.inf) / robot.lidar.range_max, 1.0)
        v, w = odometry.x / self._period / robot.max_v, odometry.theta / self._period / robot.max_w
        motions = np.clip([v, w, *action, touching], -1.0, 1.0).astype(np.float32)
        error = self._start.compose(self.slam.pose).between(self._pose)
        info = {
            "explored_fraction": np.count_nonzero(self._seen) / np.count_nonzero(self._area.explorable),
            "pose_error": np.array([math.hypot(error.x, error.y), abs(error.theta)]),
            "time": self._steps * self._period,
        }
        return gained, {"scan": scan.astype(np.float32), "map": self._crop(), "motion": motions}, info

    def _gain(self, cells: np.ndarray) -> int:
        corners = (cells[:, None, ::-1] + QUARTERS) * self._cells.resolution + self._cells.origin
        walls, seen = self._area.walls, self._seen
        true_cells = walls.cells(self._start.transform(corners.reshape(-1, 2)))
        rows, cols = true_cells[walls.contains(true_cells)].T
        new = self._area.explorable[rows, cols] & ~seen[rows, cols]
        indices = np.unique(rows[new] * seen.shape[1] + cols[new])
        seen.ravel()[indices] = True
        return len(indices)

    def _crop(self) -> np.ndarray:
        values, counts, (x, y) = self.slam.values, self.slam.counts, self.slam.to_cells(*self.slam.pose[:2])
        c, s = math.cos(self.slam.pose.theta), math.sin(self.slam.pose.theta)
        cols = np.floor(x + c * self._pixels[0] - s * self._pixels[1]).astype(np.int64)
        rows = np.floor(y + s * self._pixels[0] + c * self._pixels[1]).astype(np.int64)
        inside = (rows >= 0) & (rows < values.shape[0]) & (cols >= 0) & (cols < values.shape[1])
        rows[~inside] = cols[~inside] = 0
        known, occupied = inside & (counts[rows, cols] > 0), values[rows, cols] >= 0.5
        return np.stack([known & occupied, known & ~occupied]).astype(np.uint8) * np.uint8(255)

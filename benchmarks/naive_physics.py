"""PyBullet as it is usually written: a body per box, 240 steps per second, the lidar by `rayTestBatch`."""

import math

import numpy as np

from benchmarks.speed.halls import Hall
from envs.geometry import Pose2D
from envs.robots import LidarParams, RobotParams
from envs.simulation.bullet_bodies import CHASSIS_LINK, GROUND, ROLLING, WHEEL_LINKS, build_robot
from envs.simulation.bullet_client import BulletClient

PHYSICS_HZ = 240
"""PyBullet's usual rate [1/s]."""


class NaivePhysics:
    """A robot in a hall: one static body per box and per pillar."""

    def __init__(self, hall: Hall, robot: RobotParams, control_period: float) -> None:
        self._bullet = BulletClient()
        self._robot = robot
        self._period = control_period
        self._bullet.setGravity(0.0, 0.0, -9.81)
        self._bullet.setTimeStep(1.0 / PHYSICS_HZ)
        self._build(hall)
        self._body = build_robot(self._bullet, robot)

    def _build(self, hall: Hall) -> None:
        bullet, height = self._bullet, hall.world.height
        plane = bullet.createCollisionShape(bullet.GEOM_PLANE)
        plane = bullet.createMultiBody(0.0, plane)
        bullet.setCollisionFilterGroupMask(plane, -1, GROUND, ROLLING)
        for box in hall.boxes:
            half_extents = [0.5 * box.length, 0.5 * box.width, 0.5 * height]
            shape = bullet.createCollisionShape(bullet.GEOM_BOX, halfExtents=half_extents)
            position, yaw = [box.x, box.y, 0.5 * height], bullet.getQuaternionFromEuler([0.0, 0.0, box.yaw])
            bullet.createMultiBody(0.0, shape, -1, position, yaw)
        for x, y, radius in hall.world.circles.tolist():
            shape = bullet.createCollisionShape(bullet.GEOM_CYLINDER, radius=radius, height=height)
            bullet.createMultiBody(0.0, shape, -1, [x, y, 0.5 * height])

    def reset(self, pose: Pose2D) -> None:
        """Put the robot at rest at `pose`."""
        position = [pose.x, pose.y, self._robot.drive.wheel_radius]
        orientation = self._bullet.getQuaternionFromEuler([0.0, 0.0, pose.theta])
        self._bullet.resetBasePositionAndOrientation(self._body, position, orientation)
        self._bullet.resetBaseVelocity(self._body, [0.0] * 3, [0.0] * 3)
        for wheel in WHEEL_LINKS:
            self._bullet.resetJointState(self._body, wheel, 0.0, 0.0)
        self._v = self._w = 0.0

    def step(self, v: float, w: float) -> bool:
        """Drive with a twist [m/s, rad/s] for one control period; return whether the robot touches anything."""
        robot, assumed = self._robot, self._robot.odometry
        change_v, change_w = robot.max_acc_v * self._period, robot.max_acc_w * self._period
        self._v += min(max(v - self._v, -change_v), change_v)
        self._w += min(max(w - self._w, -change_w), change_w)
        aside = 0.5 * self._w * assumed.track
        self._bullet.setJointMotorControlArray(
            self._body,
            WHEEL_LINKS,
            self._bullet.VELOCITY_CONTROL,
            targetVelocities=[(self._v - aside) / assumed.wheel_radius, (self._v + aside) / assumed.wheel_radius],
            forces=[robot.drive.max_torque] * 2,
        )
        for _ in range(round(PHYSICS_HZ * self._period)):
            self._bullet.stepSimulation()
        return len(self._bullet.getContactPoints(self._body, linkIndexA=CHASSIS_LINK)) > 0

    def pose(self) -> Pose2D:
        """Return the true pose."""
        (x, y, _), orientation = self._bullet.getBasePositionAndOrientation(self._body)
        return Pose2D(x, y, self._bullet.getEulerFromQuaternion(orientation)[2])

    def ticks(self) -> tuple[int, int]:
        """Return the encoders' cumulative counts, left and right."""
        left, right = self._bullet.getJointStates(self._body, WHEEL_LINKS)
        per_radian = self._robot.odometry.ticks_per_rev / (2.0 * math.pi)
        return math.floor(left[0] * per_radian), math.floor(right[0] * per_radian)

    def scan(self, pose: Pose2D, rng: np.random.Generator) -> np.ndarray:
        """Return what the lidar of a robot at `pose` measures: shape (num_beams,), float32 [m]; see `Reading`."""
        lidar = self._robot.lidar
        sensor = pose.compose(Pose2D(lidar.mount.x, lidar.mount.y, lidar.mount.yaw))
        angles = sensor.theta + lidar.angles
        starts = np.tile([sensor.x, sensor.y, lidar.mount.z], (lidar.num_beams, 1))
        ends = starts.copy()
        ends[:, 0] += lidar.range_max * np.cos(angles)
        ends[:, 1] += lidar.range_max * np.sin(angles)
        hits = self._bullet.rayTestBatch(starts, ends)
        fractions = np.array([hit[2] for hit in hits])
        return disturb(fractions * lidar.range_max, fractions < 1.0, lidar, rng)

    def close(self) -> None:
        """Disconnect from PyBullet."""
        self._bullet.close()


def disturb(exact: np.ndarray, hit: np.ndarray, lidar: LidarParams, rng: np.random.Generator) -> np.ndarray:
    """Add noise to ranges and round them: shape (num_beams,), float32, inf for no return, NaN for too near a one."""
    measured = exact + lidar.noise_std * rng.standard_normal(exact.shape)
    if lidar.resolution > 0.0:
        measured = lidar.resolution * np.floor(measured / lidar.resolution + 0.5)
    measured[(exact < lidar.range_min) | (measured < lidar.range_min)] = np.nan
    measured[~hit | (measured > lidar.range_max)] = np.inf
    return measured.astype(np.float32)

"""Robots whose numbers lie in rows of arrays, for kernels that step them.

Physics are kinematic, and the SLAM matches key scans. What the kernels leave to do is done by the environments' own
objects: `sync` brings these up to date, and `load` reads them.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from envs.core import LidarEnv
from envs.estimation import NO_UPDATE, MapUpdate
from envs.estimation.motion import GyroMotion, WheelMotion
from envs.geometry import Pose2D
from envs.ground_truth import pose_error
from envs.robot import Robot
from envs.simulation import KinematicSimulator, Reading, Twist
from envs.simulation.sensors import HEADING, LEFT_TICKS, RIGHT_TICKS, TOUCHED, YAW_RATE
from envs.simulation.state import THETA
from envs.slam import KnownPoses, TinySlam
from envs.slam.key_scans import KeyScanSlam
from envs.tasks.explore import Explore
from envs.tasks.rewards import RewardWeights

from .kernels import Rows, Setup


def _matches_key_scans(slam: Any) -> bool:
    """Tell whether a SLAM's poses follow odometry between key scans; see `KeyScanSlam`."""
    if not isinstance(slam, KeyScanSlam) or type(slam).update is not KeyScanSlam.update:
        return False
    if slam.params.match_every_scan and type(slam) is not KnownPoses:
        return False
    is_composed = type(slam)._predict is KeyScanSlam._predict
    return is_composed or (type(slam) is TinySlam and slam.params.odometry == "robot_frame")


def is_fusible(env: Any) -> bool:
    """Tell whether an environment can be stepped by kernels: nothing in it is the user's own, or looks at each step."""
    if type(env) is not LidarEnv or type(env.task) is not Explore or env.task.return_home or env.sensors:
        return False
    if type(env.simulator) is not KinematicSimulator or env.on_period:
        return False
    robot = env.robots[0]
    return (
        type(robot) is Robot
        and type(robot.odometry) in (WheelMotion, GyroMotion)
        and _matches_key_scans(robot.estimator)
        and type(env.task.weights) is RewardWeights
    )


class FusedRobots:
    """The robots of equal fusible environments, a row each."""

    def __init__(self, envs: Sequence[Any]) -> None:
        """Make room for the environments' robots."""
        env, num_envs = envs[0], len(envs)
        robot, simulator = env.robots[0], env.simulator
        params, lidar, odometry = robot.estimator.params, env.robot.lidar, env.robot.odometry
        self.envs = envs
        self.setup = Setup(
            period=env.control_period,
            metres_per_tick=odometry.metres_per_tick,
            track=float(odometry.track),
            uses_gyro=isinstance(robot.odometry, GyroMotion),
            gyro_variance=env.robot.imu.gyro_std**2,
            uses_truth=robot.ground_truth is not None,
            min_travel_distance=float(params.min_travel_distance),
            min_travel_angle=float(params.min_travel_angle),
        )
        sensors = simulator.sensors

        def zeros(*shape: int, dtype: Any = np.float64) -> np.ndarray:
            return np.zeros((num_envs, *shape), dtype)

        self.rows = Rows(
            robot=zeros(*simulator.sensors.numbers.shape),
            states=zeros(*simulator.rows.shape),
            commands=zeros(*simulator.commands.shape),
            draws=zeros(*sensors.draws.shape),
            ranges=zeros(1, lidar.num_beams, dtype=np.float32),
            others=zeros(*sensors.others.shape),
            path_length=zeros(),
            collisions=zeros(dtype=np.int64),
            flags=zeros(dtype=np.uint8),
            active=np.ones(num_envs, dtype=np.bool_),
            **{name: zeros(3) for name in ("pose", "odometry", "key_pose", "map_pose")},
            **{name: zeros(2) for name in ("ticks", "twist", "gyro", "trail", "true_trail", "error")},
        )
        self.actions = zeros(2)
        """Shape (num_envs, 2), float64: the last actions."""
        self.steps = zeros(dtype=np.int64)
        """Shape (num_envs,), int64: control periods since the resets."""

    def process_key_scan(self, i: int) -> MapUpdate:
        """Let the SLAM of a robot process its scan; return how the map changed."""
        rows, env = self.rows, self.envs[i]
        robot, predicted = env.robots[0], Pose2D(*rows.pose[i].tolist())
        belief = robot.estimator.process_key_scan(rows.ranges[i, 0], predicted)
        robot.follow(belief)
        rows.pose[i], rows.key_pose[i], rows.trail[i] = belief.pose, robot.estimator.last_key_pose, robot.trail.last
        rows.error[i] = pose_error(*env.map_pose, *belief.pose, *rows.states[i, 0, : THETA + 1].tolist())
        return belief.update

    def sync(self, i: int) -> None:
        """Bring the objects of an environment up to date."""
        rows, env = self.rows, self.envs[i]
        simulator, robot, truth = env.simulator, env.robots[0], env.truths[0]
        others, steps = rows.others[i, 0].tolist(), int(self.steps[i])
        ticks = int(others[LEFT_TICKS]), int(others[RIGHT_TICKS])
        simulator.go_to(steps)
        ranges, is_touched = rows.ranges[i, 0].copy(), others[TOUCHED] > 0.0
        time = steps * self.setup.period
        reading = Reading(time, ranges, ticks, others[YAW_RATE], others[HEADING], is_touched)
        robot.reading, robot.twist = reading, Twist(*rows.twist[i].tolist())
        robot.action, robot.collisions = tuple(self.actions[i].tolist()), int(rows.collisions[i])
        robot.odometry.resume(reading)
        belief = robot.belief
        belief.pose = robot.predicted_pose = Pose2D(*rows.pose[i].tolist())
        belief.update = NO_UPDATE
        truth.state, truth.path_length = simulator.states[0], float(rows.path_length[i])
        if robot.ground_truth is not None:
            robot.ground_truth.reset(reading)

    def load(self, i: int) -> None:
        """Take the numbers of an environment from its objects; its simulator looks into the rows from now on."""
        rows, env = self.rows, self.envs[i]
        robot, truth, simulator = env.robots[0], env.truths[0], env.simulator
        sensors = simulator.sensors
        rows.robot[i], rows.states[i], rows.others[i] = sensors.numbers, simulator.rows, sensors.others
        simulator.rows, simulator.commands = rows.states[i], rows.commands[i]
        sensors.draws, sensors.others = rows.draws[i], rows.others[i]
        reading = robot.reading
        rows.ranges[i, 0], rows.pose[i], rows.map_pose[i] = reading.ranges, robot.belief.pose, env.map_pose
        rows.key_pose[i] = robot.estimator.last_key_pose
        if self.setup.uses_gyro:
            rows.gyro[i] = robot.odometry.gyro
            robot.odometry.gyro = rows.gyro[i]
        rows.ticks[i], rows.twist[i], self.actions[i] = reading.ticks, robot.twist, robot.action
        rows.trail[i], rows.true_trail[i] = robot.trail.last, truth.trail.last
        rows.path_length[i], rows.collisions[i] = truth.path_length, robot.collisions
        self.steps[i] = simulator.steps

"""Robots whose numbers lie in rows of arrays, for kernels that step them: kinematic physics, a map-matching SLAM.

The kernels call the functions that `KinematicSimulator`, the motion sources, `TinySlam` and `KnownPoses` call. What
they leave to do is done by the environments' own objects: `sync` brings these up to date, and `load` reads them.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from envs.estimation import NO_UPDATE
from envs.estimation.motion import GyroMotion, WheelMotion
from envs.explore import ExploreEnv
from envs.geometry import Pose2D
from envs.robot import Robot
from envs.simulation import KinematicSimulator, Reading, Twist
from envs.simulation.sensors import HEADING, LEFT_TICKS, RIGHT_TICKS, TOUCHED, YAW_RATE
from envs.slam import KnownPoses, TinySlam
from envs.slam.matcher import search_params
from envs.tasks.rewards import RewardWeights

from .kernels import RAW, Rows, Setup


def is_fusible(env: Any) -> bool:
    """Tell whether an environment can be stepped by kernels: nothing in it is the user's own, or looks at each step."""
    if type(env) is not ExploreEnv or type(env.simulator) is not KinematicSimulator or env.on_period:
        return False
    robot = env.robots[0]
    slam = robot.estimator
    return (
        type(robot) is Robot
        and type(robot.odometry) in (WheelMotion, GyroMotion)
        and (type(slam) is KnownPoses or (type(slam) is TinySlam and not slam.observers))
        and slam.params.odometry == "robot_frame"
        and type(env.task.weights) is RewardWeights
    )


class FusedRobots:
    """The robots of equal fusible environments, a row each."""

    def __init__(self, envs: Sequence[Any]) -> None:
        """Make room for the environments' robots."""
        env, num_envs = envs[0], len(envs)
        robot, simulator = env.robots[0], env.simulator
        slam = robot.estimator
        params, lidar, odometry = slam.params, env.robot.lidar, env.robot.odometry
        matches = isinstance(slam, TinySlam)
        self.envs = envs
        self.setup = Setup(
            robot=simulator.sensors.numbers,
            period=env.control_period,
            geometry=slam.map.geometry,
            search=search_params(params),
            metres_per_tick=odometry.metres_per_tick,
            track=float(odometry.track),
            uses_gyro=isinstance(robot.odometry, GyroMotion),
            uses_truth=robot.ground_truth is not None,
            matches=matches,
            min_travel_distance=float(params.min_travel_distance),
            min_travel_angle=float(params.min_travel_angle),
        )
        sensors, tries = simulator.sensors, params.max_tries if matches else 0

        def zeros(*shape: int, dtype: Any = np.float64) -> np.ndarray:
            return np.zeros((num_envs, *shape), dtype)

        self.rows = Rows(
            states=zeros(*simulator.rows.shape),
            commands=zeros(*simulator.commands.shape),
            draws=zeros(*sensors.draws.shape),
            ranges=zeros(1, lidar.num_beams, dtype=np.float32),
            others=zeros(*sensors.others.shape),
            noise=zeros(tries, 3),
            corner=zeros(2, dtype=np.int64),
            path_length=zeros(),
            collisions=zeros(dtype=np.int64),
            flags=zeros(dtype=np.uint8),
            active=np.ones(num_envs, dtype=np.bool_),
            **{name: zeros(3) for name in ("pose", "odometry", "integrated", "map_pose")},
            **{name: zeros(2) for name in ("ticks", "twist", "trail", "true_trail", "error")},
        )
        self.points = np.empty((2, lidar.num_beams), dtype=np.float32)
        self.actions = zeros(2)
        """Shape (num_envs, 2), float64: the last actions."""
        self.steps = zeros(dtype=np.int64)
        """Shape (num_envs,), int64: control periods since the resets."""

    def integrate(self, i: int, flags: int) -> Any:
        """Integrate the scan of a robot into its map as the matcher's flags ask; return the `MapUpdate`."""
        rows, robot = self.rows, self.envs[i].robots[0]
        slam, pose = robot.estimator, Pose2D(*rows.pose[i].tolist())
        quality = slam.params.raw_quality if flags & RAW else slam.params.quality
        update = slam.map.integrate(rows.ranges[i, 0], pose, quality)
        slam.last_integrated_pose, rows.integrated[i] = pose, pose
        robot.pyramid.update(update)
        return update

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
        robot.odometry.reset(reading)
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
        rows.states[i], rows.others[i] = simulator.rows, sensors.others
        simulator.rows, simulator.commands = rows.states[i], rows.commands[i]
        sensors.draws, sensors.others = rows.draws[i], rows.others[i]
        reading = robot.reading
        rows.ranges[i, 0], rows.pose[i], rows.map_pose[i] = reading.ranges, robot.belief.pose, env.map_pose
        rows.integrated[i] = robot.estimator.last_integrated_pose
        rows.ticks[i], rows.twist[i], self.actions[i] = reading.ticks, robot.twist, robot.action
        rows.trail[i], rows.true_trail[i] = robot.trail.last, truth.trail.last
        rows.path_length[i], rows.collisions[i] = truth.path_length, robot.collisions
        self.steps[i] = simulator.steps
        self.load_map(i)

    def load_map(self, i: int) -> None:
        """Take note of where the map of an environment lies, which changes when it grows."""
        self.rows.corner[i] = self.envs[i].robots[0].estimator.map.corner

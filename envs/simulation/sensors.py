"""The robots' sensors and their noise, the same under both physics."""

import math
from collections.abc import Sequence

import numpy as np
from numba import njit

from envs.geometry import wrap_angle
from envs.geometry.raycast import cast_rays
from envs.robots import RobotParams, pack_robot, robot_record, unpack_robot

from .simulator import Reading
from .state import GYRO_BIAS, LEFT_ANGLE, MEAN_W, RIGHT_ANGLE, THETA, X, Y

SLIP_LEFT, SLIP_RIGHT, GYRO, COMPASS = range(4)
"""Entries of a robot's standard normal draws in a control period; those of the beams follow."""
OTHER_NORMALS = 4
"""Number of normal draws before the beams' own."""
LEFT_TICKS, RIGHT_TICKS, YAW_RATE, HEADING, TOUCHED = range(5)
"""Entries of the measurements beside the scan: encoder counts, gyroscope [rad/s], compass [rad], 1 for contact."""
NUM_OTHERS = 5
"""Number of these entries."""


@njit(cache=True, error_model="numpy")
def disturb_ranges(ranges, normals, uniforms, lidar):
    """Turn exact ranges into measured ones, in place.

    Args:
        ranges: shape (num_beams,), float32 [m], inf where nothing lies within range.
        normals: shape (num_beams,), float64, standard normal draws.
        uniforms: shape (num_beams,), float64, uniform draws in [0, 1); may be empty where the dropout is 0.
        lidar: `LidarRecord`. What lies or seems nearer than the least range becomes NaN, what seems beyond the
            greatest becomes inf, and lost beams become NaN.
    """
    for k in range(ranges.shape[0]):
        exact = float(ranges[k])
        measured = exact + lidar.noise_std * normals[k]
        if lidar.resolution > 0.0:
            measured = lidar.resolution * math.floor(measured / lidar.resolution + 0.5)
        if lidar.dropout > 0.0 and uniforms[k] < lidar.dropout:
            ranges[k] = np.nan
        elif exact == np.inf or measured > lidar.range_max:
            ranges[k] = np.inf
        elif exact < lidar.range_min or measured < lidar.range_min:
            ranges[k] = np.nan
        else:
            ranges[k] = measured


@njit(cache=True, error_model="numpy")
def measure_ranges(pose, normals, uniforms, lidar, segments, circles, ranges):
    """Take a scan.

    Args:
        pose: (x, y, theta) of the base, world frame [m, m, rad]; further entries are ignored.
        normals: shape (num_beams,), float64, standard normal draws.
        uniforms: shape (num_beams,), float64, uniform draws in [0, 1); may be empty where the dropout is 0.
        lidar: `LidarRecord`.
        segments: shape (n, 4), float64: obstacles, (x0, y0, x1, y1) [m].
        circles: shape (m, 3), float64: obstacles and movers, (x, y, radius) [m].
        ranges: shape (num_beams,), float32, written; see `Reading`.
    """
    c, s = math.cos(pose[2]), math.sin(pose[2])
    cast_rays(
        pose[0] + c * lidar.mount_x - s * lidar.mount_y,
        pose[1] + s * lidar.mount_x + c * lidar.mount_y,
        pose[2] + lidar.mount_yaw,
        lidar,
        segments,
        circles,
        ranges,
    )
    disturb_ranges(ranges, normals, uniforms, lidar)


@njit(cache=True, error_model="numpy")
def with_peers(circles, states, index, radius):
    """Return obstacles and the other robots as circles, shape (m + num_robots - 1, 3), float64 [m].

    Args:
        circles: shape (m, 3), float64: (x, y, radius) [m].
        states: shape (num_robots, 11), float64; see `state`.
        index: of the robot that is left out.
        radius: of the robots' footprints [m].
    """
    count, num_robots = circles.shape[0], states.shape[0]
    joined = np.empty((count + num_robots - 1, 3))
    joined[:count] = circles
    for k in range(num_robots):
        if k != index:
            row = count + k - (k > index)
            joined[row, 0], joined[row, 1], joined[row, 2] = states[k, X], states[k, Y], radius
    return joined


@njit(cache=True, error_model="numpy")
def measure_yaw_rate(state, normals, imu):
    """Return what a robot's gyroscope measures in a control period [rad/s].

    Args:
        state: shape (11,), float64; see `state`.
        normals: shape (n,), float64, standard normal draws; see `SLIP_LEFT`.
        imu: `ImuRecord`.
    """
    return state[MEAN_W] + state[GYRO_BIAS] + imu.gyro_std * normals[GYRO]


@njit(cache=True, error_model="numpy")
def sense(states, normals, uniforms, robot, segments, circles, ranges, others):
    """Measure what all robots sense, but for contact, which the physics determines.

    Args:
        states: shape (num_robots, 11), float64; see `state`.
        normals: shape (num_robots, 4 + num_beams), float64, standard normal draws.
        uniforms: shape (num_robots, num_beams), float64, uniform draws in [0, 1); (num_robots, 0) without dropout.
        robot: from `pack_robot`.
        segments: shape (n, 4), float64: obstacles, (x0, y0, x1, y1) [m].
        circles: shape (m, 3), float64: obstacles and movers, (x, y, radius) [m].
        ranges: shape (num_robots, num_beams), float32 [m], written; see `Reading`.
        others: shape (num_robots, 5), float64, written; see `LEFT_TICKS`.
    """
    drive, lidar, imu, ticks_per_radian = unpack_robot(robot)
    for k in range(states.shape[0]):
        state, draws, row = states[k], normals[k], others[k]
        visible = with_peers(circles, states, k, drive.radius)
        measure_ranges(state, draws[OTHER_NORMALS:], uniforms[k], lidar, segments, visible, ranges[k])
        row[LEFT_TICKS] = math.floor(state[LEFT_ANGLE] * ticks_per_radian)
        row[RIGHT_TICKS] = math.floor(state[RIGHT_ANGLE] * ticks_per_radian)
        row[YAW_RATE] = measure_yaw_rate(state, draws, imu)
        heading = np.nan
        if imu.has_compass:
            heading = state[THETA] + imu.compass_std * draws[COMPASS]
            if imu.compass_resolution > 0.0:
                heading = imu.compass_resolution * math.floor(heading / imu.compass_resolution + 0.5)
            heading = wrap_angle(heading)
        row[HEADING] = heading


class Sensors:
    """Noise and measurements of several equal robots.

    All noise of a control period is drawn at once, before the robots move: the order of draws depends neither on the
    physics nor on what the robots meet.
    """

    def __init__(self, robot: RobotParams, num_robots: int) -> None:
        lidar, self._gyro_bias_std = robot.lidar, robot.imu.gyro_bias_std
        self._robot = pack_robot(robot_record(robot))
        self._shape = num_robots, lidar.num_beams
        self.normals = np.zeros((num_robots, OTHER_NORMALS + lidar.num_beams))
        """Standard normal draws of this control period, shape (num_robots, 4 + num_beams); see `SLIP_LEFT`."""
        self.uniforms = np.zeros((num_robots, lidar.num_beams if lidar.dropout > 0.0 else 0))
        """Uniform draws, shape (num_robots, num_beams), or (num_robots, 0) for a lidar without dropout."""
        self.ranges = np.empty(self._shape, dtype=np.float32)
        """Scans, shape (num_robots, num_beams), float32 [m]: a new array in each control period."""
        self.others = np.zeros((num_robots, NUM_OTHERS))
        """The other measurements, shape (num_robots, 5); see `LEFT_TICKS`."""

    def draw(self, rngs: Sequence[np.random.Generator]) -> None:
        """Draw the noise of a control period, each robot's from its own generator."""
        for k, rng in enumerate(rngs):
            rng.standard_normal(out=self.normals[k])
            if self.uniforms.size:
                rng.random(out=self.uniforms[k])
        self.ranges = np.empty(self._shape, dtype=np.float32)

    def draw_biases(self, states: np.ndarray) -> None:
        """Write each gyroscope's bias of an episode to its state, by the draw that slip leaves unused at a reset.

        Args:
            states: shape (num_robots, 11), float64; see `state`.
        """
        states[:, GYRO_BIAS] = self._gyro_bias_std * self.normals[:, SLIP_LEFT]

    def sense(self, states: np.ndarray, segments: np.ndarray, circles: np.ndarray) -> None:
        """Measure everything but contact; see the function of this name for the arguments."""
        sense(states, self.normals, self.uniforms, self._robot, segments, circles, self.ranges, self.others)

    def readings(self, time: float) -> list[Reading]:
        """Return the measurements, made `time` [s] after the reset."""
        return [
            Reading(time, ranges, (int(left), int(right)), yaw_rate, heading, touched > 0.0)
            for ranges, (left, right, yaw_rate, heading, touched) in zip(self.ranges, self.others.tolist(), strict=True)
        ]

"""The robot's sensors and their noise, the same under both physics."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from envs.geometry import Pose2D, wrap_angle
from envs.geometry.raycast import cast_rays
from envs.robots import LidarParams, RobotParams

from .simulator import Reading

OTHER_NORMALS = 4
"""Normal draws of a control period besides the beams' own: slip of both wheels, gyroscope, compass."""


@njit(cache=True, error_model="numpy")
def disturb_ranges(ranges, normals, uniforms, noise_std, resolution, range_min, range_max, dropout):
    """Turn exact ranges into measured ones, in place.

    Args:
        ranges: shape (num_beams,), float32 [m], inf where nothing lies within range.
        normals: shape (num_beams,), float64, standard normal draws.
        uniforms: shape (num_beams,), float64, uniform draws in [0, 1); may be empty where `dropout` is 0.
        noise_std: standard deviation of the noise [m].
        resolution: step of the ranges [m]; 0 for none.
        range_min: nearest return; what lies or seems nearer becomes NaN [m].
        range_max: farthest return; what seems farther becomes inf [m].
        dropout: probability that a beam is lost, and becomes NaN.
    """
    for k in range(ranges.shape[0]):
        exact = float(ranges[k])
        measured = exact + noise_std * normals[k]
        if resolution > 0.0:
            measured = resolution * math.floor(measured / resolution + 0.5)
        if dropout > 0.0 and uniforms[k] < dropout:
            ranges[k] = np.nan
        elif exact == np.inf or measured > range_max:
            ranges[k] = np.inf
        elif exact < range_min or measured < range_min:
            ranges[k] = np.nan
        else:
            ranges[k] = measured


class LidarNumbers(NamedTuple):
    """The numbers of `LidarParams`, as scalars that Numba takes; units as there."""

    mount_x: float
    mount_y: float
    mount_yaw: float
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float
    noise_std: float
    resolution: float
    dropout: float

    @classmethod
    def of(cls, lidar: LidarParams) -> "LidarNumbers":
        """Collect the numbers of a lidar."""
        mount = (lidar.mount.x, lidar.mount.y, lidar.mount.yaw)
        angles = (lidar.angle_min, lidar.angle_increment)
        noise = (lidar.noise_std, lidar.resolution, lidar.dropout)
        return cls(*map(float, (*mount, *angles, lidar.range_min, lidar.range_max, *noise)))


@njit(cache=True, error_model="numpy")
def measure_ranges(x, y, theta, normals, uniforms, lidar, segments, circles, ranges):
    """Take a scan.

    Args:
        x: position of the base, world frame [m].
        y: position of the base, world frame [m].
        theta: heading of the base [rad].
        normals: shape (num_beams,), float64, standard normal draws.
        uniforms: shape (num_beams,), float64, uniform draws in [0, 1); may be empty where no beams are lost.
        lidar: the sensor, `LidarNumbers`.
        segments: shape (n, 4), float64, the world's [m].
        circles: shape (m, 3), float64, the world's with its movers [m].
        ranges: shape (num_beams,), float32, written; see `Reading`.
    """
    c, s = math.cos(theta), math.sin(theta)
    cast_rays(
        x + c * lidar.mount_x - s * lidar.mount_y,
        y + s * lidar.mount_x + c * lidar.mount_y,
        theta + lidar.mount_yaw,
        lidar.angle_min,
        lidar.angle_increment,
        lidar.range_max,
        segments,
        circles,
        ranges,
    )
    disturb_ranges(
        ranges,
        normals,
        uniforms,
        lidar.noise_std,
        lidar.resolution,
        lidar.range_min,
        lidar.range_max,
        lidar.dropout,
    )


class Sensors:
    """Everything that a robot measures.

    All noise of a control period comes from one block of draws, `draw`, taken before the robot moves: the order of
    draws depends neither on the physics nor on what the robot meets.
    """

    def __init__(self, robot: RobotParams) -> None:
        self._robot = robot
        self._lidar = LidarNumbers.of(robot.lidar)
        self._ticks_per_radian = robot.odometry.ticks_per_rev / (2.0 * math.pi)
        self._no_uniforms = np.empty(0)

    def draw(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Draw the noise of one control period.

        Returns:
            Standard normal draws, shape (4 + num_beams,): slip of the left and the right wheel, gyroscope, compass,
            beams; and uniform draws, shape (num_beams,), or (0,) for a lidar that loses no beams.
        """
        lidar = self._robot.lidar
        normals = rng.standard_normal(OTHER_NORMALS + lidar.num_beams)
        return normals, rng.random(lidar.num_beams) if lidar.dropout > 0.0 else self._no_uniforms

    def read(
        self,
        noise: tuple[np.ndarray, np.ndarray],
        time: float,
        pose: Pose2D,
        wheel_angles: tuple[float, float],
        yaw_rate: float,
        bumper: bool,
        segments: np.ndarray,
        circles: np.ndarray,
    ) -> Reading:
        """Measure.

        Args:
            noise: from `draw`.
            time: since the reset [s].
            pose: of the base, in the world frame.
            wheel_angles: how far the left and the right wheel have turned since the reset, as encoders see it [rad].
            yaw_rate: of the base [rad/s].
            bumper: whether the body touched anything during the period.
            segments: shape (n, 4), float64, the world's [m].
            circles: shape (m, 3), float64, the world's with its movers [m].
        """
        normals, uniforms = noise
        imu = self._robot.imu
        heading = math.nan
        if imu.has_compass:
            heading = pose.theta + imu.compass_std * normals[3]
            if imu.compass_resolution > 0.0:
                heading = imu.compass_resolution * math.floor(heading / imu.compass_resolution + 0.5)
            heading = float(wrap_angle(heading))
        ranges = np.empty(self._robot.lidar.num_beams, dtype=np.float32)
        measure_ranges(*pose, normals[OTHER_NORMALS:], uniforms, self._lidar, segments, circles, ranges)
        return Reading(
            time=time,
            ranges=ranges,
            ticks=(
                math.floor(wheel_angles[0] * self._ticks_per_radian),
                math.floor(wheel_angles[1] * self._ticks_per_radian),
            ),
            yaw_rate=float(yaw_rate + imu.gyro_std * normals[2]),
            heading=heading,
            bumper=bool(bumper),
        )

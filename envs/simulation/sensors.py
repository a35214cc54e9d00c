"""The robot's sensors and their noise, the same under both physics."""

import math

import numpy as np
from numba import njit

from envs.geometry import Pose2D, wrap_angle
from envs.geometry.raycast import cast_rays
from envs.robots import RobotParams

from .simulator import Reading

_OTHER_NORMALS = 4
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


class Sensors:
    """Everything that a robot measures.

    All noise of a control period comes from one block of draws, `draw`, taken before the robot moves: the order of
    draws depends neither on the physics nor on what the robot meets.
    """

    def __init__(self, robot: RobotParams) -> None:
        self._robot = robot
        self._angle_min = float(robot.lidar.angle_min)
        self._angle_increment = float(robot.lidar.angle_increment)
        self._ticks_per_radian = robot.odometry.ticks_per_rev / (2.0 * math.pi)
        self._no_uniforms = np.empty(0)

    def draw(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Draw the noise of one control period.

        Returns:
            Standard normal draws, shape (4 + num_beams,): slip of the left and the right wheel, gyroscope, compass,
            beams; and uniform draws, shape (num_beams,), or (0,) for a lidar that loses no beams.
        """
        lidar = self._robot.lidar
        normals = rng.standard_normal(_OTHER_NORMALS + lidar.num_beams)
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
        return Reading(
            time=time,
            ranges=self._scan(pose, normals[_OTHER_NORMALS:], uniforms, segments, circles),
            ticks=(
                math.floor(wheel_angles[0] * self._ticks_per_radian),
                math.floor(wheel_angles[1] * self._ticks_per_radian),
            ),
            yaw_rate=float(yaw_rate + imu.gyro_std * normals[2]),
            heading=heading,
            bumper=bool(bumper),
        )

    def _scan(
        self, pose: Pose2D, normals: np.ndarray, uniforms: np.ndarray, segments: np.ndarray, circles: np.ndarray
    ) -> np.ndarray:
        lidar = self._robot.lidar
        mount = lidar.mount
        c, s = math.cos(pose.theta), math.sin(pose.theta)
        ranges = np.empty(lidar.num_beams, dtype=np.float32)
        cast_rays(
            pose.x + c * mount.x - s * mount.y,
            pose.y + s * mount.x + c * mount.y,
            pose.theta + mount.yaw,
            self._angle_min,
            self._angle_increment,
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
        return ranges

"""The robots' sensors and their noise, the same under both physics."""

import math
from collections.abc import Sequence

import numpy as np
from numba import njit

from envs.geometry import wrap_angle
from envs.geometry.raycast import cast_rays
from envs.robots import RobotParams

from .records import robot_record, unpack_robot
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
def tilt_ranges(ranges, robot):
    """Turn exact ranges of a level lidar into those of a tilted one, in place: walls farther along, and the floor.

    A beam at azimuth a points by sin(pitch) cos(a) - cos(pitch) sin(roll) sin(a) of its length down (rotations by yaw,
    pitch, roll as in REP 103). Walls are taken to have no upper end. That a tilt also turns beams, by a quarter of its
    square at most, 0.1 degrees at 5, is left out.

    Args:
        ranges: shape (num_beams,), float32 [m], inf where nothing lies within range.
        robot: `RobotRecord`.
    """
    down_ahead, down_left = math.sin(robot.mount_pitch), -math.cos(robot.mount_pitch) * math.sin(robot.mount_roll)
    for k in range(ranges.shape[0]):
        azimuth = robot.angle_min + k * robot.angle_increment
        down = down_ahead * math.cos(azimuth) + down_left * math.sin(azimuth)
        exact = float(ranges[k]) / math.sqrt(1.0 - down * down)
        if down > 0.0:
            exact = min(exact, robot.mount_z / down)
        ranges[k] = exact if exact <= robot.range_max else np.inf


@njit(cache=True, error_model="numpy")
def disturb_ranges(ranges, draws, robot):
    """Turn exact ranges into measured ones, in place.

    What lies or seems nearer than the least range becomes NaN, what seems beyond the greatest becomes inf, and lost
    beams become NaN.

    Args:
        ranges: shape (num_beams,), float32 [m], inf where nothing lies within range.
        draws: float64, a standard normal draw for each beam, then, for a lidar with dropout, a uniform one in [0, 1).
        robot: `RobotRecord`.
    """
    num_beams = ranges.shape[0]
    for k in range(num_beams):
        exact = float(ranges[k])
        measured = exact + robot.range_std * draws[k]
        if robot.range_resolution > 0.0:
            measured = robot.range_resolution * math.floor(measured / robot.range_resolution + 0.5)
        if robot.dropout > 0.0 and draws[num_beams + k] < robot.dropout:
            ranges[k] = np.nan
        elif exact == np.inf or measured > robot.range_max:
            ranges[k] = np.inf
        elif exact < robot.range_min or measured < robot.range_min:
            ranges[k] = np.nan
        else:
            ranges[k] = measured


@njit(cache=True, error_model="numpy")
def measure_ranges(pose, draws, robot, segments, circles, ranges):
    """Take a scan.

    Args:
        pose: (x, y, theta) of the base, world frame [m, m, rad]; further entries are ignored.
        draws: see `disturb_ranges`.
        robot: `RobotRecord`.
        segments: shape (n, 4), float64: obstacles, (x0, y0, x1, y1) [m].
        circles: shape (m, 3), float64: obstacles and movers, (x, y, radius) [m].
        ranges: shape (num_beams,), float32, written; see `Reading`.
    """
    c, s = math.cos(pose[2]), math.sin(pose[2])
    x = pose[0] + c * robot.mount_x - s * robot.mount_y
    y = pose[1] + s * robot.mount_x + c * robot.mount_y
    cast_rays(x, y, pose[2] + robot.mount_yaw, robot, segments, circles, ranges)
    if robot.mount_pitch != 0.0 or robot.mount_roll != 0.0:
        tilt_ranges(ranges, robot)
    disturb_ranges(ranges, draws, robot)


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
def sense(states, draws, numbers, segments, circles, ranges, others):
    """Measure what all robots sense, but for contact, which the physics determines.

    Args:
        states: shape (num_robots, 11), float64; see `state`.
        draws: shape (num_robots, n), float64; see `Sensors.draws`.
        numbers: for `unpack_robot`.
        segments: shape (n, 4), float64: obstacles, (x0, y0, x1, y1) [m].
        circles: shape (m, 3), float64: obstacles and movers, (x, y, radius) [m].
        ranges: shape (num_robots, num_beams), float32 [m], written; see `Reading`.
        others: shape (num_robots, 5), float64, written; see `LEFT_TICKS`.
    """
    robot = unpack_robot(numbers)
    for k in range(states.shape[0]):
        state, noise, row = states[k], draws[k], others[k]
        visible = with_peers(circles, states, k, robot.radius)
        measure_ranges(state, noise[OTHER_NORMALS:], robot, segments, visible, ranges[k])
        row[LEFT_TICKS] = math.floor(state[LEFT_ANGLE] * robot.ticks_per_radian)
        row[RIGHT_TICKS] = math.floor(state[RIGHT_ANGLE] * robot.ticks_per_radian)
        row[YAW_RATE] = state[MEAN_W] + state[GYRO_BIAS] + robot.gyro_std * noise[GYRO]
        heading = np.nan
        if robot.has_compass:
            heading = state[THETA] + robot.compass_std * noise[COMPASS]
            if robot.compass_resolution > 0.0:
                heading = robot.compass_resolution * math.floor(heading / robot.compass_resolution + 0.5)
            heading = wrap_angle(heading)
        row[HEADING] = heading


class Sensors:
    """Noise and measurements of several equal robots.

    All noise of a control period is drawn at once, before the robots move: the order of draws depends neither on the
    physics nor on what the robots meet.
    """

    def __init__(self, robot: RobotParams, control_period: float, num_robots: int) -> None:
        num_beams, self._num_uniforms = robot.lidar.num_beams, 0
        self.draws = np.zeros((num_robots, OTHER_NORMALS + num_beams))
        """Noise of this control period, shape (num_robots, n): standard normal draws, see `SLIP_LEFT`, and one for each
        beam; then, once the lidar has had dropout, a uniform draw in [0, 1) for each beam."""
        self.ranges = np.empty((num_robots, num_beams), dtype=np.float32)
        """Scans, shape (num_robots, num_beams), float32 [m]."""
        self.others = np.zeros((num_robots, NUM_OTHERS))
        """The other measurements, shape (num_robots, 5); see `LEFT_TICKS`."""
        self.set_robot(robot, control_period)

    def set_robot(self, robot: RobotParams, control_period: float) -> None:
        """Change the robots' parameters; the number of beams stays as it was."""
        self._gyro_bias_std = robot.imu.gyro_bias_std
        self.numbers = np.array(robot_record(robot, control_period))
        """The robots' `RobotRecord` as an array."""
        if robot.lidar.dropout > 0.0 and not self._num_uniforms:
            self._num_uniforms = robot.lidar.num_beams
            self.draws = np.zeros((len(self.draws), OTHER_NORMALS + 2 * self._num_uniforms))

    def draw(self, rngs: Sequence[np.random.Generator]) -> None:
        """Draw the noise of a control period, each robot's from its own generator."""
        for k, rng in enumerate(rngs):
            self.draw_rows(rng, self.draws[k : k + 1])

    def draw_rows(self, rng: np.random.Generator, rows: np.ndarray) -> None:
        """Draw the noise of one robot for n control periods to `rows`, shape (n, k), float64; see `draws`."""
        if not self._num_uniforms:
            rng.standard_normal(out=rows)
            return
        for row in rows:
            rng.standard_normal(out=row[: -self._num_uniforms])
            rng.random(out=row[-self._num_uniforms :])

    def draw_biases(self, states: np.ndarray) -> None:
        """Write each gyroscope's bias of an episode to its state, by the draw that slip leaves unused at a reset.

        Args:
            states: shape (num_robots, 11), float64; see `state`.
        """
        states[:, GYRO_BIAS] = self._gyro_bias_std * self.draws[:, SLIP_LEFT]

    def sense(self, states: np.ndarray, segments: np.ndarray, circles: np.ndarray) -> None:
        """Measure everything but contact; see the function of this name for the arguments."""
        sense(states, self.draws, self.numbers, segments, circles, self.ranges, self.others)

    def readings(self, time: float) -> list[Reading]:
        """Return the measurements, made `time` [s] after the reset, in fresh arrays."""
        return [
            Reading(time, ranges, (int(left), int(right)), yaw_rate, heading, touched > 0.0)
            for ranges, (left, right, yaw_rate, heading, touched) in zip(self.ranges.copy(), self.others.tolist())
        ]

"""Noisy lidar, encoders, gyroscope and compass, for all physics engines."""

import math

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry import wrap_angle
from lidarnaut.envs.geometry.raycast import cast_rays
from lidarnaut.envs.geometry.rows import write_row

from .odometry import update_odometry
from .records import unpack_robot

SLIP_LEFT, SLIP_RIGHT, GYRO, COMPASS = range(4)
"""Indices of the random numbers for wheel slip, gyroscope and compass in a control period; those for lidar beams
follow."""
OTHER_NORMALS = 4


@njit(cache=True, error_model="numpy")
def tilt_ranges(ranges, robot):
    """Convert exact ranges of a level lidar to ranges of a tilted lidar, in place.

    Walls have unlimited height; beams may hit the floor; changes of azimuth are neglected.
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
    """Add noise, rounding and dropout to exact lidar ranges, in place.

    `ranges`: shape (num_beams,), float32 [m]; inf without a hit. `draws`: random numbers: a standard normal number per
    beam; then, with dropout, a uniform number in [0, 1) per beam.
    """
    num_beams = ranges.shape[0]
    for k in range(num_beams):
        exact = float(ranges[k])
        measured = exact + robot.range_std * draws[k]
        if robot.range_resolution > 0.0 and exact < np.inf:
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
    """Simulate a noisy lidar scan from the robot's base pose (x, y, theta) in the world frame.

    `segments`, `circles`: obstacles [m]. `ranges`: output, shape (num_beams,), float32 [m].
    """
    c, s = math.cos(pose[2]), math.sin(pose[2])
    x = pose[0] + c * robot.mount_x - s * robot.mount_y
    y = pose[1] + s * robot.mount_x + c * robot.mount_y
    cast_rays(x, y, pose[2] + robot.mount_yaw, robot, segments, circles, ranges)
    if robot.mount_pitch != 0.0 or robot.mount_roll != 0.0:
        tilt_ranges(ranges, robot)
    disturb_ranges(ranges, draws, robot)


@njit(cache=True, error_model="numpy")
def with_room(circles, num_more):
    """Return a copy of the circles (x, y, radius), shape (m, 3) [m], with space for `num_more` circles at the end."""
    extended = np.empty((circles.shape[0] + num_more, 3))
    for row in range(circles.shape[0]):
        write_row(extended[row], circles[row])
    return extended


@njit(cache=True, error_model="numpy")
def with_peers(circles, rows, index, radius):
    """Return obstacle circles (x, y, radius) [m], followed by the footprints of all robots except robot `index`."""
    count, num_robots = circles.shape[0], rows.shape[0]
    extended = with_room(circles, num_robots - 1)
    for k in range(num_robots):
        if k != index:
            write_row(extended[count + k - (k > index)], (rows[k].x, rows[k].y, radius))
    return extended


@njit(cache=True, error_model="numpy")
def measure_heading(pose, normal, robot, magnets):
    """Return the compass heading of a robot at a pose (x, y, theta) in the world frame [rad].

    `normal`: standard normal number for noise. `magnets`: magnetic sources, see `World.magnets`.
    """
    heading = pose[2] + robot.compass_offset
    heading += robot.compass_deviation * math.sin(pose[2] - robot.compass_deviation_phase)
    for k in range(magnets.shape[0]):
        distance = math.hypot(pose[0] - magnets[k, 0], pose[1] - magnets[k, 1])
        heading += magnets[k, 2] * max(distance, 1.0) ** -magnets[k, 3]
    heading += robot.compass_std * normal
    if robot.compass_resolution > 0.0:
        heading = robot.compass_resolution * math.floor(heading / robot.compass_resolution + 0.5)
    return wrap_angle(heading)


@njit(cache=True, error_model="numpy")
def sense(rows, draws, ranges, segments, circles, magnets):
    """Simulate all sensors of all robots except contact, and update the odometry.

    Args:
        rows: records, shape (num_robots,), dtype `ROW`, updated.
        draws: random numbers for noise, n per control period, shape (num_robots, BLOCK, n), float64.
        ranges: output, shape (num_robots, num_beams), float32 [m].
        segments: walls (x0, y0, x1, y1), shape (n, 4), float64 [m].
        circles: obstacles and people (x, y, radius), shape (m, 3), float64 [m].
        magnets: magnetic sources that disturb compasses, shape (k, 4), float64, see `World.magnets`.
    """
    robot = unpack_robot(rows[0])
    for k in range(rows.shape[0]):
        row = rows[k]
        noise = draws[k, int(row.draw)]
        visible, pose = with_peers(circles, rows, k, robot.radius), (row.x, row.y, row.theta)
        measure_ranges(pose, noise[OTHER_NORMALS:], robot, segments, visible, ranges[k])
        row.yaw_rate = row.mean_w + row.gyro_bias + robot.gyro_std * noise[GYRO]
        left, right = row.left_angle * robot.ticks_per_radian, row.right_angle * robot.ticks_per_radian
        update_odometry(row, math.floor(left), math.floor(right))
        row.heading = measure_heading(pose, noise[COMPASS], robot, magnets) if robot.has_compass else np.nan

"""The pilot: drives along a path, gets the robot free, and tells when the drive is over. Kernels over one record."""

import math

import numpy as np
from numba import njit

from envs.frontier_choice.nearby import frontier_near
from envs.frontier_choice.records import ARRIVED, DRIVING, FAILED, GONE, LOOKED, REPLAN, TIME_UP
from envs.geometry.pose import wrap_angle
from envs.navigation.obstacles import add_bump, free_distance, remember, scan_points
from envs.navigation.pursuit import follow, turn_rate


@njit(cache=True, error_model="numpy")
def sense(pilot, obstacles, ranges, directions, v, w, bumper, numbers):
    """Take in a scan: what the lidar no longer sees is remembered and moves along by odometry.

    Args:
        pilot: record of type `PILOT`, written.
        obstacles: shape (n, 2), float64, written: the first `pilot.num_obstacles` are what stands around, base
            frame [m].
        ranges: shape (num_beams,), float32 [m], as in `Reading`.
        directions: shape (2, num_beams), float64: cosine and sine of the beams in the base frame.
        v: forward speed by odometry [m/s].
        w: yaw rate by odometry [rad/s].
        bumper: whether the robot touched anything.
        numbers: `PilotNumbers`.
    """
    length, angle = v * numbers.period, w * numbers.period
    kept = remember(
        obstacles,
        pilot.num_remembered,
        pilot.num_obstacles,
        length * math.cos(0.5 * angle),
        length * math.sin(0.5 * angle),
        angle,
        numbers.mount,
        numbers.half_fov,
        numbers.range_min,
        numbers.range_far,
    )
    if bumper:
        kept = add_bump(obstacles, kept, numbers.follower.radius, pilot.forward == 1)
    pilot.num_remembered = kept
    mount = numbers.mount
    count = scan_points(ranges, np.inf, 1.0, directions[0], directions[1], mount[0], mount[1], obstacles[kept:])
    pilot.num_obstacles = kept + count


@njit(cache=True, error_model="numpy")
def set_out(pilot, num_points, goal_x, goal_y, frontier_x, frontier_y):
    """Begin a drive along a path of `num_points` to a goal, to look at a frontier, map frame [m]."""
    pilot.num_points = num_points
    pilot.index = 0
    pilot.goal_x, pilot.goal_y = goal_x, goal_y
    pilot.frontier_x, pilot.frontier_y = frontier_x, frontier_y
    pilot.has_goal = 1
    pilot.steps = pilot.planned = 0
    pilot.stall_steps = -1
    pilot.recoveries = 0
    pilot.back_steps = pilot.turn_steps = 0


@njit(cache=True, error_model="numpy")
def look_around(pilot, numbers):
    """Begin a full turn on the spot instead of a drive."""
    pilot.has_goal = 0
    pilot.steps = 0
    pilot.recoveries = 0
    pilot.back_steps = 0
    pilot.turn_w = numbers.spin_rate
    pilot.turn_steps = math.ceil(2.0 * math.pi / numbers.spin_rate / numbers.period)


@njit(cache=True, error_model="numpy")
def _bearing(pilot, x, y, theta, numbers):
    """Return by how much to turn at the goal to get the frontier well into view [rad]; 0 if it is."""
    dx, dy = pilot.frontier_x - x, pilot.frontier_y - y
    if numbers.sees_around or math.hypot(dx, dy) <= 0.05:
        return 0.0
    bearing = wrap_angle(math.atan2(dy, dx) - theta - numbers.mount[2])
    return bearing if abs(bearing) > 0.8 * numbers.half_fov else 0.0


@njit(cache=True, error_model="numpy")
def _at_goal(pilot, x, y, numbers):
    return math.hypot(pilot.goal_x - x, pilot.goal_y - y) <= numbers.goal_tolerance


@njit(cache=True, error_model="numpy")
def act(pilot, path, obstacles, x, y, theta, v_now, numbers, command):
    """Choose the next command.

    Args:
        pilot: record of type `PILOT`, written.
        path: shape (n, 2), float64, map frame [m].
        obstacles: see `sense`.
        x: believed position, map frame [m].
        y: the same [m].
        theta: believed heading [rad].
        v_now: forward speed by odometry [m/s].
        numbers: `PilotNumbers`.
        command: shape (2,), float32, written: forward speed and yaw rate over the robot's limits.
    """
    follower = numbers.follower
    around = obstacles[: pilot.num_obstacles]
    v, w = 0.0, 0.0
    if pilot.back_steps > 0:
        pilot.back_steps -= 1
        look = 2.0 * pilot.back_v * numbers.period
        if free_distance(around, 0.0, follower.radius, look) < 0.5 * abs(look):
            pilot.back_steps = 0
        else:
            v = pilot.back_v
    elif pilot.turn_steps > 0:
        pilot.turn_steps -= 1
        w = pilot.turn_w
    elif pilot.has_goal:
        if _at_goal(pilot, x, y, numbers):
            w = turn_rate(_bearing(pilot, x, y, theta, numbers), follower)
        else:
            v, w, _ = follow(pilot, path[: pilot.num_points], x, y, theta, v_now, around, follower)
    pilot.forward = 1 if v >= 0.0 else 0
    command[0] = min(max(v / follower.max_v, -1.0), 1.0)
    command[1] = min(max(w / numbers.max_w, -1.0), 1.0)


@njit(cache=True, error_model="numpy")
def _recover(pilot, around, backwards, numbers):
    """Leave the place straight on, or to the side with more room, and turn a little, left and right in turn."""
    pilot.recoveries += 1
    radius, reach = numbers.follower.radius, numbers.back_reach
    sign = -1.0 if backwards else 1.0
    room = free_distance(around, 0.0, radius, sign * reach)
    if room < 0.5 * reach and free_distance(around, 0.0, radius, -sign * reach) > room:
        sign = -sign
    pilot.back_v = sign * numbers.back_speed
    pilot.back_steps = max(1, round(reach / numbers.back_speed / numbers.period))
    # 0.6, 0.8, 1.0 rad: another direction each time.
    angle = 0.4 + 0.2 * pilot.recoveries
    pilot.turn_w = numbers.spin_rate * pilot.side * (1.0 if pilot.recoveries % 2 else -1.0)
    pilot.turn_steps = max(1, round(angle / numbers.spin_rate / numbers.period))
    pilot.stall_steps = -1


@njit(cache=True, error_model="numpy")
def _count_still(pilot, x, y, theta, numbers):
    """Count the steps for which the robot has not moved or turned, and for which it has not come far."""
    moved = math.hypot(x - pilot.stall_x, y - pilot.stall_y) >= numbers.stall_distance
    moved |= abs(wrap_angle(theta - pilot.stall_theta)) >= numbers.stall_angle
    if pilot.stall_steps < 0 or moved:
        pilot.stall_x, pilot.stall_y, pilot.stall_theta = x, y, theta
        pilot.stall_steps = 0
    else:
        pilot.stall_steps += 1
    if pilot.stuck_steps < 0 or math.hypot(x - pilot.stuck_x, y - pilot.stuck_y) >= numbers.stuck_distance:
        pilot.stuck_x, pilot.stuck_y = x, y
        pilot.stuck_steps = 0
    else:
        pilot.stuck_steps += 1


@njit(cache=True, error_model="numpy")
def judge(pilot, obstacles, x, y, theta, bumper, data, resolution, left, low, block, given_up, numbers):
    """Decide, once a step is made and `sense` has taken in its scan, how the drive goes on.

    Args:
        pilot: record of type `PILOT`, written.
        obstacles: see `sense`.
        x: believed position, map frame [m].
        y: the same [m].
        theta: believed heading [rad].
        bumper: whether the robot touched anything.
        data: shape (rows, cols), int8, occupancy of the map.
        resolution: side of its cells [m].
        left: where its first column begins, map frame [m].
        low: where its first row begins [m].
        block: side of a planning cell [map cells].
        given_up: see `frontier_near`.
        numbers: `PilotNumbers`.

    Returns:
        `DRIVING` or one of what follows there.
    """
    around = obstacles[: pilot.num_obstacles]
    pilot.steps += 1
    if bumper and pilot.back_steps == 0 and pilot.turn_steps == 0:
        _recover(pilot, around, pilot.forward == 1, numbers)
    if pilot.recoveries > numbers.max_recoveries:
        return FAILED if pilot.has_goal else LOOKED
    if pilot.back_steps > 0 or pilot.turn_steps > 0:
        return DRIVING
    if not pilot.has_goal:
        return LOOKED
    if pilot.steps >= numbers.min_steps:
        place, radius = (pilot.frontier_x, pilot.frontier_y), numbers.frontier_radius
        if len(frontier_near(data, left, low, resolution, block, place[0], place[1], radius, given_up)) == 0:
            return GONE
    if _at_goal(pilot, x, y, numbers) and _bearing(pilot, x, y, theta, numbers) == 0.0:
        return ARRIVED
    _count_still(pilot, x, y, theta, numbers)
    # The robot may have been stuck before it set out: what is chosen anew gets a decision's time all the same.
    if pilot.stuck_steps > numbers.stuck_steps and pilot.steps >= min(numbers.stuck_steps, numbers.max_steps):
        pilot.stuck_steps = -1
        return FAILED
    if pilot.stall_steps > numbers.stall_steps:
        _recover(pilot, around, True, numbers)
        return DRIVING
    if pilot.steps >= numbers.max_steps:
        return TIME_UP
    if pilot.steps - pilot.planned >= numbers.replan_steps:
        pilot.planned = pilot.steps
        return REPLAN
    return DRIVING

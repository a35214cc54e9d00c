"""Compiled functions of `Navigator`: obstacle memory, velocity commands, recovery and progress checks, as in Nav2.

- `navigators`: state, shape (1,), dtype `NAVIGATOR`. `constants`: shape (1,), fields of `navigator_numbers`.
- `obstacles`: points, shape (n, 2), base frame [m], `num_obstacles` of them valid. `others`: points on other robots.
- `sensors`: ranges as in `Reading`, `ScanGeometry`, bumper.
- `motion`: base pose relative to the last call. `pose`: pose estimate, map frame [m, rad].
"""

import math

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.estimation.scan_points import project_hits
from lidarnaut.envs.geometry.lookup import record_type
from lidarnaut.envs.geometry.pose import wrap_angle
from lidarnaut.envs.navigation.controllers.regulated_pursuit import FOLLOWER_FIELDS, follow, follower_numbers, turn_rate
from lidarnaut.envs.navigation.maps.obstacles import add_bump, forget_inside, free_distance, remember
from lidarnaut.envs.navigation.maps.planning_params import NavigatorParams
from lidarnaut.envs.robots import RobotParams

DRIVING, REPLAN, REACHED, FAILED, TIME_UP, SPUN = range(6)
"""Status of a drive. `REPLAN`: replanning is due. `SPUN`: a spin is completed."""
WELL_IN_VIEW = 0.8
"""Central fraction of the field of view that must contain the chosen frontier before the robot stops turning."""
REPLAN_TIME, STALL_TIME, STALL_ANGLE = 4.0, 3.0, 0.3
"""Interval between replans of the path [s]; time without translation or rotation that triggers a recovery behavior [s];
minimum heading change that counts as rotation [rad]."""
SPIN_RATE = 1.0
"""Yaw rate of recovery spins [rad/s], limited by the robot."""
CONTACT_MARGIN = 0.05
"""A stalled robot deletes remembered obstacles within this gap to its footprint [m], as contacts may enclose it."""
NAVIGATOR = record_type(
    [
        *FOLLOWER_FIELDS,
        ("goal_x", np.float64),
        ("goal_y", np.float64),
        ("view_x", np.float64),  # to see from the goal; NaN for none
        ("view_y", np.float64),
        ("has_goal", np.int64),
        ("steps", np.int64),
        ("planned", np.int64),
        ("stall_x", np.float64),  # pose at the last motion
        ("stall_y", np.float64),
        ("stall_theta", np.float64),
        ("stall_steps", np.int64),
        ("stuck_x", np.float64),  # position at the last large displacement
        ("stuck_y", np.float64),
        ("stuck_steps", np.int64),
        ("recoveries", np.int64),
        ("back_v", np.float64),  # BackUp, then Spin
        ("back_steps", np.int64),
        ("turn_w", np.float64),
        ("turn_steps", np.int64),
        ("forward", np.int64),
        ("pressed", np.int64),  # bumper state of the last reading
        ("marked", np.int64),  # contacts may be remembered
        ("num_remembered", np.int64),  # obstacles, see `remember`
        ("num_seen", np.int64),  # and visible obstacles
        ("num_obstacles", np.int64),  # and other robots
    ]
)
"""Structured dtype of a navigator's state, map frame [m, rad]."""


def navigator_numbers(
    robot: RobotParams, period: float, max_time: float, params: NavigatorParams
) -> dict[str, float | tuple[float, ...]]:
    """Return robot and navigator constants for compiled functions.

    `period`: control period [s]. `max_time`: maximum drive time [s].
    """
    lidar = robot.lidar
    times = {"max": max_time, "replan": REPLAN_TIME, "stall": STALL_TIME, "stuck": params.stuck_time}
    return {
        **follower_numbers(robot, period),
        "max_recoveries": math.inf if params.max_recoveries is None else params.max_recoveries,
        "stuck_distance": params.stuck_distance,
        **{f"{name}_steps": max(1, round(min(seconds, 1e6) / period)) for name, seconds in times.items()},
        "mount": (lidar.mount.x, lidar.mount.y, lidar.mount.yaw),
        # A beam's width avoids gaps in full turns.
        "half_fov": 0.5 * lidar.fov + lidar.angle_increment,
        "sees_around": lidar.fov > 2.0 * math.pi - 0.1,
        "range_min": lidar.range_min,
        "range_far": 2.0 * robot.radius + 0.3,  # range of remembered points
        "goal_tolerance": min(params.goal_tolerance * robot.radius, params.max_goal_tolerance),
        "stall_distance": 0.25 * robot.radius + 0.02,
        "spin_rate": min(robot.max_w, SPIN_RATE),
        "back_reach": 0.5 * robot.radius + 0.1,
        "back_speed": min(0.4 * robot.max_v, 0.4),
    }


@njit(cache=True, error_model="numpy")
def update_obstacles(navigators, obstacles, sensors, motion, others, constants):
    """Update obstacle points with a scan.

    Points outside the field of view are remembered and moved by odometry. A new bumper contact replaces remembered
    points inside the footprint, since points of several contacts would enclose a turning robot.
    """
    record, numbers = navigators[0], constants[0]
    ranges, geometry, bumper = sensors
    kept = remember(obstacles, record.num_remembered, record.num_seen, motion, numbers)
    if bumper and record.pressed == 0:
        kept -= forget_inside(obstacles, kept, kept, numbers.radius)
        kept = add_bump(obstacles, kept, numbers.radius, record.forward == 1)
        record.marked = 1
    record.pressed = 1 if bumper else 0
    record.num_remembered = kept
    count = project_hits(ranges, geometry, obstacles[kept:].T)
    record.num_seen = kept + count
    record.num_obstacles = kept + count + others.shape[0]
    for k in range(others.shape[0]):
        obstacles[kept + count + k, 0], obstacles[kept + count + k, 1] = others[k, 0], others[k, 1]


@njit(cache=True, error_model="numpy")
def _turn_to_view(record, pose, numbers):
    dx, dy = record.view_x - pose[0], record.view_y - pose[1]
    if numbers.sees_around or not math.hypot(dx, dy) > 0.05:
        return 0.0
    bearing = wrap_angle(math.atan2(dy, dx) - pose[2] - numbers.mount[2])
    return bearing if abs(bearing) > WELL_IN_VIEW * numbers.half_fov else 0.0


@njit(cache=True, error_model="numpy")
def _is_at_goal(record, pose, numbers):
    return math.hypot(record.goal_x - pose[0], record.goal_y - pose[1]) <= numbers.goal_tolerance


@njit(cache=True, error_model="numpy")
def compute_velocity_command(navigators, path, obstacles, pose, v_now, constants):
    """Return the next velocity command: forward speed [m/s] and yaw rate [rad/s], within the robot's limits.

    `path`: shape (n, 2), map frame [m]. `v_now`: forward speed by odometry [m/s].
    """
    record, numbers = navigators[0], constants[0]
    points = obstacles[: record.num_obstacles]
    v, w = 0.0, 0.0
    if record.back_steps > 0:
        record.back_steps -= 1
        # Braking distance.
        look = record.back_v * numbers.period + 0.5 * record.back_v * abs(record.back_v) / numbers.braking_v
        if free_distance(points, 0.0, numbers.radius, look) < abs(look):
            record.back_steps = 0
        else:
            v = record.back_v
    elif record.turn_steps > 0:
        record.turn_steps -= 1
        w = record.turn_w
    elif record.has_goal:
        if _is_at_goal(record, pose, numbers):
            w = turn_rate(_turn_to_view(record, pose, numbers), numbers)
        else:
            v, w, _ = follow(record, path, pose[0], pose[1], pose[2], v_now, points, numbers)
    record.forward = 1 if v >= 0.0 else 0
    v, w = min(max(v, -numbers.max_v), numbers.max_v), min(max(w, -numbers.max_w), numbers.max_w)
    return v, w


@njit(cache=True, error_model="numpy")
def recover(navigators, points, backwards, constants):
    """Begin a recovery behavior: back up, or drive forward if there is more room, then spin, to alternating sides."""
    record, numbers = navigators[0], constants[0]
    record.recoveries += 1
    radius, reach = numbers.radius, numbers.back_reach
    sign = -1.0 if backwards else 1.0
    room = free_distance(points, 0.0, radius, sign * reach)
    if room < 0.5 * reach and free_distance(points, 0.0, radius, -sign * reach) > room:
        sign = -sign
    record.back_v = sign * numbers.back_speed
    record.back_steps = max(1, round(reach / numbers.back_speed / numbers.period))
    angle = 0.4 + 0.2 * min(record.recoveries, 5)
    record.turn_w = numbers.spin_rate * record.side * (1.0 if record.recoveries % 2 else -1.0)
    record.turn_steps = max(1, round(angle / numbers.spin_rate / numbers.period))
    record.stall_steps = -1


@njit(cache=True, error_model="numpy")
def _count_still(record, pose, numbers):
    x, y, theta = pose
    moved = math.hypot(x - record.stall_x, y - record.stall_y) >= numbers.stall_distance
    moved |= abs(wrap_angle(theta - record.stall_theta)) >= STALL_ANGLE
    if record.stall_steps < 0 or moved:
        record.stall_x, record.stall_y, record.stall_theta = x, y, theta
        record.stall_steps = 0
    else:
        record.stall_steps += 1
    if record.stuck_steps < 0 or math.hypot(x - record.stuck_x, y - record.stuck_y) >= numbers.stuck_distance:
        record.stuck_x, record.stuck_y = x, y
        record.stuck_steps = 0
    else:
        record.stuck_steps += 1


@njit(cache=True, error_model="numpy")
def _forget(record, obstacles, radius):
    dropped = forget_inside(obstacles, record.num_remembered, record.num_obstacles, radius)
    record.num_remembered -= dropped
    record.num_seen -= dropped
    record.num_obstacles -= dropped


@njit(cache=True, error_model="numpy")
def check_progress(navigators, obstacles, pose, bumper, constants):
    """Return the status of the drive, such as `DRIVING`; begin a recovery behavior after a stall."""
    record, numbers = navigators[0], constants[0]
    points = obstacles[: record.num_obstacles]
    record.steps += 1
    if bumper and record.back_steps == 0 and record.turn_steps == 0:
        recover(navigators, points, record.forward == 1, constants)
    if record.recoveries > numbers.max_recoveries:
        if record.has_goal:
            _forget(record, obstacles, numbers.radius)
            return FAILED
        return SPUN
    if record.back_steps > 0 or record.turn_steps > 0:
        return DRIVING
    if not record.has_goal:
        return SPUN
    if _is_at_goal(record, pose, numbers) and _turn_to_view(record, pose, numbers) == 0.0:
        return REACHED
    _count_still(record, pose, numbers)
    # A robot that was stuck before gets full time for a new goal.
    if record.stuck_steps > numbers.stuck_steps and record.steps >= min(numbers.stuck_steps, numbers.max_steps):
        record.stuck_steps = -1
        _forget(record, obstacles, numbers.radius)
        return FAILED
    if record.stall_steps > numbers.stall_steps:
        recover(navigators, points, True, constants)
        if record.marked == 1:  # contacts may enclose the robot
            record.marked = 0
            _forget(record, obstacles, numbers.radius + CONTACT_MARGIN)
        return DRIVING
    if record.steps >= numbers.max_steps:
        return TIME_UP
    if record.steps - record.planned >= numbers.replan_steps:
        record.planned = record.steps
        return REPLAN
    return DRIVING

"""Records of a navigator: its state from step to step, its numbers, and its progress."""

import math

import numpy as np

from envs.navigation.params import NavigatorParams
from envs.navigation.pursuit import FOLLOWER_FIELDS, follower_numbers
from envs.robots import RobotParams

DRIVING, REPLAN, REACHED, FAILED, TIME_UP, SPUN = range(6)
"""Progress of a drive: it goes on; it goes on once the path is planned anew; the robot is at its goal; the robot does
not get there; the time for the drive is over; a turn on the spot is complete."""

NAVIGATOR = np.dtype(
    [
        *FOLLOWER_FIELDS,
        ("num_points", np.int64),  # of the path
        ("goal_x", np.float64),
        ("goal_y", np.float64),
        ("view_x", np.float64),  # what to have in view at the goal; NaN for nothing
        ("view_y", np.float64),
        ("has_goal", np.int64),
        ("steps", np.int64),  # of this drive
        ("planned", np.int64),  # step at which the path was planned last
        ("stall_x", np.float64),  # where the robot last was when it had moved or turned
        ("stall_y", np.float64),
        ("stall_theta", np.float64),
        ("stall_steps", np.int64),
        ("stuck_x", np.float64),  # where it last was when it had come some distance
        ("stuck_y", np.float64),
        ("stuck_steps", np.int64),
        ("recoveries", np.int64),
        ("back_v", np.float64),  # BackUp for some steps, then Spin for some
        ("back_steps", np.int64),
        ("turn_w", np.float64),
        ("turn_steps", np.int64),
        ("forward", np.int64),  # whether the last command was not backwards
        ("num_remembered", np.int64),  # obstacles, see `remember`
        ("num_seen", np.int64),  # those, and what the last scan shows
        ("num_obstacles", np.int64),  # those, and other robots
    ]
)
"""What a navigator keeps from step to step, in the map frame, m and rad."""


def navigator_numbers(
    robot: RobotParams, period: float, max_time: float, params: NavigatorParams
) -> dict[str, float | tuple[float, ...]]:
    """Return the numbers for drives of at most `max_time` seconds with a command every `period` seconds; m, s, rad."""
    lidar = robot.lidar

    def steps(seconds: float) -> int:
        return max(1, round(min(seconds, 1e6) / period))

    return {
        **follower_numbers(robot, period),
        "mount": (lidar.mount.x, lidar.mount.y, lidar.mount.yaw),
        # A full turn has no directions beside its view; a beam's width keeps rounding from making one.
        "half_fov": 0.5 * lidar.fov + lidar.angle_increment,
        "sees_around": lidar.fov > 2.0 * math.pi - 0.1,
        "range_min": lidar.range_min,
        "range_far": 2.0 * robot.radius + 0.3,  # up to which obstacles beside the lidar's view are remembered
        "goal_tolerance": min(params.goal_tolerance * robot.radius, 0.2),
        "max_steps": steps(max_time),
        "replan_steps": steps(params.replan_time),
        "stall_distance": 0.25 * robot.radius + 0.02,
        "stall_angle": params.stall_angle,
        "stall_steps": steps(params.stall_time),
        "stuck_distance": params.stuck_distance,
        "stuck_steps": steps(params.stuck_time),
        "max_recoveries": params.max_recoveries,
        "spin_rate": min(robot.max_w, params.spin_rate),
        "back_reach": 0.5 * robot.radius + 0.1,  # how far the robot backs up
        "back_speed": 0.4 * robot.max_v,
    }

import math

import numpy as np
import pytest

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.navigation import DwbPlanner, MppiPlanner, PathFollower
from lidarnaut.envs.navigation.controllers.regulated_pursuit import (
    FOLLOWER_FIELDS,
    as_record,
    follow,
    follower_numbers,
    record_type,
)
from lidarnaut.envs.robots import ROBOT_NAMES, load_robot
from lidarnaut.envs.simulation import Twist
from tests.navigation.driving import PERIOD, drive, path_through
from tests.rooms import ORIGIN

PLANNERS = {
    "rpp": PathFollower,
    "dwb": DwbPlanner,
    "mppi": lambda robot, period: MppiPlanner(robot, period, np.random.default_rng(0)),
}
CASES = [
    *((name, "rpp") for name in ROBOT_NAMES),
    *((name, "dwb") for name in ("turtlebot3_waffle_pi", "tugbot", "mpo_500")),
    *((name, "mppi") for name in ("turtlebot3_burger", "tugbot", "mpo_500")),
]
"""All robots with the fast planner; three robots of different speeds and accelerations with the slow planners."""
STRAYS = {"rpp": 0.25, "dwb": 0.6, "mppi": 0.6}
"""Maximum deviation of each planner from a path with sharp corners [m]; DWB cuts corners in free space."""
STOPS = {"rpp": 0.15, "dwb": 0.2, "mppi": 0.4}
"""Maximum stopping distance of each planner before a wall [m]; DWB rounds to cells."""


@pytest.mark.parametrize(("name", "planner"), CASES)
def test_every_robot_stays_on_a_winding_path(name, planner):
    robot = load_robot(name)
    path = path_through([0.0, 0.0], [1.5, 0.0], [1.5, 1.5], [0.5, 2.5], [0.5, 4.0], [2.5, 4.0])
    follower = PLANNERS[planner](robot, PERIOD)
    follower.set_path(path)
    length = np.hypot(*np.diff(path, axis=0).T).sum()
    # The robot starts with its back to the path; twice the time at full speed is enough for five corners.
    num_steps = round((2.0 * length / robot.max_v + 12.0) / PERIOD)
    poses = drive(follower, robot, Pose2D(0.0, 0.0, math.pi), num_steps, jitter=0.01)
    assert math.hypot(poses[-1].x - 2.5, poses[-1].y - 4.0) < (0.1 if planner != "mppi" else 0.2)
    away = max(np.hypot(*(path - pose[:2]).T).min() for pose in poses)
    assert away < STRAYS[planner]


@pytest.mark.parametrize(("name", "planner"), CASES)
def test_every_robot_stops_before_a_wall_and_says_that_it_is_blocked(name, planner):
    robot = load_robot(name)
    follower = PLANNERS[planner](robot, PERIOD)
    follower.set_path(path_through([0.0, 0.0], [6.0, 0.0]))
    wall = np.column_stack([np.full(3001, 3.0), np.linspace(-3.0, 3.0, 3001)])
    poses = drive(follower, robot, ORIGIN, round((10.0 / robot.max_v + 5.0) / PERIOD), walls=wall)
    gap = min(np.hypot(*(wall - pose[:2]).T).min() for pose in poses) - robot.radius
    assert 0.0 < gap < STOPS[planner]
    assert math.hypot(poses[-1].x - poses[-30].x, poses[-1].y - poses[-30].y) < (0.05 if planner != "mppi" else 0.2)
    assert follower.blocked or planner == "mppi"  # MPPI turns back and forth, and does not wait


@pytest.mark.parametrize("planner", PLANNERS)
def test_it_does_not_cut_a_corner_with_an_obstacle_in_it(planner):
    robot = load_robot("tugbot")
    follower = PLANNERS[planner](robot, PERIOD)
    follower.set_path(path_through([0.0, 0.0], [2.0, 0.0], [2.0, 2.0]))
    post = np.array([[1.5, 0.5]])
    poses = drive(follower, robot, ORIGIN, 150, walls=post)
    assert min(np.hypot(*(post - pose[:2]).T).min() for pose in poses) > robot.radius
    assert math.hypot(poses[-1].x - 2.0, poses[-1].y - 2.0) < 0.15


def test_walls_beside_the_path_do_not_slow_down_and_what_lies_on_it_does():
    robot = load_robot("turtlebot3_burger")
    follower = PathFollower(robot, PERIOD)
    follower.set_path(path_through([0.0, 0.0], [4.0, 0.0]))
    x = np.arange(-1.0, 5.0, 0.02)
    walls = np.concatenate([np.column_stack([x, np.full_like(x, side)]) for side in (-0.25, 0.25)])
    poses = drive(follower, robot, Pose2D(0.0, 0.05, 0.0), 180, walls=walls)
    speeds = np.hypot(*np.diff([pose[:2] for pose in poses], axis=0).T) / PERIOD
    assert speeds[20:160].min() > 0.95 * robot.max_v
    follower.set_path(path_through([0.0, 0.0], [4.0, 0.0]))
    assert follower.command(Pose2D(1.8, 0.0, 0.0), Twist(0.2, 0.0), np.array([[0.2, 0.0]])).v < 0.6 * robot.max_v


def test_a_robot_of_unknown_speed_plans_as_if_slow():
    numbers = as_record(follower_numbers(load_robot("turtlebot3_burger"), PERIOD))[0]
    path, wall = np.array([[0.0, 0.0], [0.5, 0.0], [1.0, 0.0]]), np.array([[0.05, 0.0]])
    states = np.zeros(2, dtype=record_type(FOLLOWER_FIELDS))
    slow, unknown = (follow(state, path, 0.0, 0.0, 0.0, v, wall, numbers) for state, v in zip(states, (0.0, math.nan)))
    assert unknown == slow

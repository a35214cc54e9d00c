import math
from dataclasses import replace

import pytest

from envs.geometry import Pose2D
from envs.robots import WheelOdometry, load_robot


@pytest.fixture
def robot():
    """Counts so fine that rounding does not show."""
    robot = load_robot("turtlebot3_burger")
    return replace(robot, odometry=replace(robot.odometry, ticks_per_rev=1e9))


def ticks(robot, left, right):
    """Counts after the wheels have rolled these distances [m]."""
    per_metre = robot.odometry.ticks_per_rev / (2 * math.pi * robot.odometry.wheel_radius)
    return round(left * per_metre), round(right * per_metre)


def test_straight_on(robot):
    odometry = WheelOdometry(robot)
    odometry.reset((5, -7))
    start = ticks(robot, 1.5, 1.5)
    assert odometry.update((start[0] + 5, start[1] - 7)) == pytest.approx((1.5, 0.0, 0.0), abs=1e-6)
    assert odometry.update((start[0] + 5, start[1] - 7)) == (0.0, 0.0, 0.0)


def test_a_turn_on_the_spot_and_a_circle(robot):
    odometry = WheelOdometry(robot)
    half = 0.5 * robot.odometry.track
    odometry.reset((0, 0))
    assert odometry.update(ticks(robot, -half * 0.3, half * 0.3)) == pytest.approx((0, 0, 0.3), abs=1e-6)
    odometry.reset((0, 0))
    quarter = math.pi / 2
    motion = odometry.update(ticks(robot, (1 - half) * quarter, (1 + half) * quarter))
    assert motion == pytest.approx((1.0, 1.0, quarter), abs=1e-6)


def test_motions_add_up_however_finely_they_are_read(robot):
    odometry = WheelOdometry(robot)
    odometry.reset((0, 0))
    pose, left, right = Pose2D(0.0, 0.0, 0.0), 0.0, 0.0
    for _ in range(100):
        left, right = left + 0.02, right + 0.023
        pose = pose.compose(odometry.update(ticks(robot, left, right)))
    odometry.reset((0, 0))
    assert pose == pytest.approx(odometry.update(ticks(robot, left, right)), abs=1e-6)

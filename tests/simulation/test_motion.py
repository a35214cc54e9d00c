"""Flat ground: the robot executes its command, times the error of its controller."""

import math
from dataclasses import replace

import numpy as np
import pytest

from envs.estimation.motion import WheelMotion
from envs.geometry import Pose2D
from envs.robots import ROBOT_NAMES, load_robot
from envs.simulation import Twist, make_simulator
from envs.simulation.kinematic import SLIP_MARGIN

SECONDS = 5


def without_slip(robot):
    return replace(robot, drive=replace(robot.drive, slip_std=0.0))


def gains(robot):
    """True over commanded forward speed, and true over commanded yaw rate."""
    forward = robot.drive.wheel_radius / robot.odometry.wheel_radius
    return forward, forward * robot.odometry.track / robot.drive.track


def drive(simulator, world, command, ramp):
    """Drive on after the ramp; return distance along the path, change of yaw, and where that led."""
    simulator.reset(world, [Pose2D(0.0, 0.0, 0.4)], [np.random.default_rng(0)])
    for _ in range(math.ceil(10 * ramp) + 2):
        simulator.step([command])
    start = simulator.states[0].pose
    distance = yaw = 0.0
    for _ in range(10 * SECONDS):
        before = simulator.states[0].pose
        simulator.step([command])
        motion = before.between(simulator.states[0].pose)
        distance += motion.x
        yaw += motion.theta
    return distance, yaw, start.between(simulator.states[0].pose)


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_straight_on_and_on_the_spot(physics, name, plain):
    robot = without_slip(load_robot(name))
    forward, turning = gains(robot)
    simulator = make_simulator(physics, robot, 0.1)
    for share in (1.0, -0.5, 0.3):
        v = share * robot.max_v
        distance, yaw, _ = drive(simulator, plain, Twist(v, 0.0), abs(v) / robot.max_acc_v)
        assert distance == pytest.approx(v * forward * SECONDS, rel=0.01)
        assert abs(yaw) < 0.01
        w = share * robot.max_w
        _, yaw, end = drive(simulator, plain, Twist(0.0, w), abs(w) / robot.max_acc_w)
        assert yaw == pytest.approx(w * turning * SECONDS, rel=0.01)
        assert math.hypot(end.x, end.y) < 0.01
    simulator.close()


def test_acceleration_is_limited(physics, plain):
    robot = without_slip(load_robot("turtlebot3_waffle_pi"))
    simulator = make_simulator(physics, robot, 0.1)
    simulator.reset(plain, [Pose2D(0.0, 0.0, 0.0)], [np.random.default_rng(0)])
    simulator.step([Twist(9.0, 0.0)])
    assert simulator.states[0].twist.v == pytest.approx(0.1 * robot.max_acc_v, rel=0.02)
    for _ in range(9):
        simulator.step([Twist(9.0, 0.0)])
    assert simulator.states[0].twist.v == pytest.approx(robot.max_v, rel=0.01)
    simulator.step([Twist(-9.0, 0.0)])
    assert simulator.states[0].twist.v == pytest.approx(robot.max_v - 0.1 * robot.max_acc_v, rel=0.02)


@pytest.mark.parametrize("name", ["turtlebot3_burger", "raspimouse", "tugbot_original"])
def test_odometry_errs_as_documented(physics, name, plain):
    robot = without_slip(load_robot(name))
    forward, turning = gains(robot)
    simulator, odometry = make_simulator(physics, robot, 0.1), WheelMotion(robot)
    for command in (Twist(robot.max_v, 0.0), Twist(0.0, 0.5 * robot.max_w)):
        reading = simulator.reset(plain, [Pose2D(0.0, 0.0, 0.0)], [np.random.default_rng(0)])[0]
        odometry.reset(reading)
        measured = true = 0.0
        for _ in range(50):
            before = simulator.states[0].pose
            reading = simulator.step([command])[0]
            motion, truth = odometry.update(reading), before.between(simulator.states[0].pose)
            measured += motion.x if command.v else motion.theta
            true += truth.x if command.v else truth.theta
        assert true / measured == pytest.approx(forward if command.v else turning, rel=0.01)


def test_slip_spreads_as_stated(physics, plain):
    """Over d metres a wheel slips with standard deviation slip_std * sqrt(d), and encoders do not see it."""
    robot = load_robot("turtlebot3_burger")
    robot = replace(robot, drive=replace(robot.drive, slip_std=0.02))
    simulator, odometry = make_simulator(physics, robot, 0.1), WheelMotion(robot)
    command = Twist(0.2, 0.0)
    headings, odometry_headings, runs = [], [], 60
    rng = np.random.default_rng(0)
    for _ in range(runs):
        odometry.reset(simulator.reset(plain, [Pose2D(0.0, 0.0, 0.0)], [rng])[0])
        for _ in range(25):
            reading = simulator.step([command])[0]
        headings.append(simulator.states[0].pose.theta)
        odometry_headings.append(odometry.update(reading).theta)
        distance = simulator.states[0].pose.x
    expected = math.sqrt(2.0) * 0.02 * math.sqrt(distance) / robot.drive.track
    assert np.std(headings) == pytest.approx(expected, rel=3.0 / math.sqrt(2 * runs))
    assert np.abs(odometry_headings).max() < 0.1 * expected


@pytest.mark.parametrize("command", [(1.0, 0.0), (0.0, 1.0), (1.0, -1.0), (0.02, 0.0)])
def test_no_slip_moves_a_robot_beyond_its_limits_and_their_margin(physics, command, plain):
    robot = load_robot("turtlebot3_burger")
    robot = replace(robot, drive=replace(robot.drive, slip_std=1.0))
    forward, turning = gains(robot)
    simulator = make_simulator(physics, robot, 0.1)
    simulator.reset(plain, [Pose2D(0.0, 0.0, 0.0)], [np.random.default_rng(0)])
    speeds, yaw_rates = [], []
    for _ in range(100):
        before = simulator.states[0].pose
        simulator.step([Twist(command[0] * robot.max_v, command[1] * robot.max_w)])
        motion = before.between(simulator.states[0].pose)
        speeds.append(math.hypot(motion.x, motion.y) / 0.1)
        yaw_rates.append(abs(motion.theta) / 0.1)
    limits = (1.0 + SLIP_MARGIN) * forward * robot.max_v, (1.0 + SLIP_MARGIN) * turning * robot.max_w
    more = 1.001 if physics == "kinematic" else 1.3  # a body of some mass overshoots, and pitches
    assert max(speeds) < more * limits[0]
    assert max(yaw_rates) < more * limits[1]
    simulator.close()


def test_the_control_period_changes_the_time_of_a_step_alone(physics, plain):
    robot = without_slip(load_robot("turtlebot3_burger"))
    ends = []
    for period, steps in ((0.1, 30), (0.05, 60), (0.5, 6)):
        simulator = make_simulator(physics, robot, period)
        simulator.reset(plain, [Pose2D(0.0, 0.0, 0.0)], [np.random.default_rng(0)])
        for _ in range(steps):
            reading = simulator.step([Twist(0.2, 0.5)])[0]
        assert reading.time == pytest.approx(3.0)
        ends.append(simulator.states[0].pose)
    np.testing.assert_allclose(ends[1], ends[0], atol=2e-3)
    np.testing.assert_allclose(ends[2], ends[0], atol=2e-3)

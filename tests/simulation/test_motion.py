import math
from dataclasses import replace

import numpy as np
import pytest

from lidarnaut.envs.geometry import Pose2D, wrap_angle
from lidarnaut.envs.robots import ROBOT_NAMES, load_robot
from lidarnaut.envs.simulation import PHYSICS, Twist, make_simulator
from lidarnaut.envs.simulation.kinematic import SLIP_MARGIN
from tests.rooms import BURGER, ORIGIN, PLAIN, begin, without_slip

SECONDS = 5


def by_wheels(robot):
    """The robot with odometry of the wheels alone."""
    return replace(robot, odometry=replace(robot.odometry, uses_gyro=False))


def gains(robot):
    """True over commanded forward speed, and true over commanded yaw rate."""
    forward = robot.drive.wheel_radius / robot.odometry.wheel_radius
    return forward, forward * robot.odometry.track / robot.drive.track


def motions(simulator, command, steps):
    for _ in range(steps):
        before = simulator.states[0].pose
        reading = simulator.step([command])[0]
        yield before.between(simulator.states[0].pose), reading


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_straight_on_and_on_the_spot_wheels_measure_what_is_commanded(physics, name):
    robot = by_wheels(without_slip(load_robot(name)))
    forward, turning = gains(robot)
    for share in (1.0, -0.5, 0.3):
        v, w = share * robot.max_v, share * robot.max_w
        for command, ramp in ((Twist(v, 0.0), v / robot.max_acc_v), (Twist(0.0, w), w / robot.max_acc_w)):
            simulator = begin(physics, robot, PLAIN, Pose2D(0.0, 0.0, 0.4))
            for _ in motions(simulator, command, math.ceil(10 * abs(ramp)) + 2):
                pass
            start, record = simulator.states[0].pose, list(motions(simulator, command, 10 * SECONDS))
            distance, _, yaw = np.sum([motion for motion, _ in record], axis=0)
            measured = np.sum([reading.motion for _, reading in record], axis=0)
            assert distance == pytest.approx(command.v * forward * SECONDS, rel=0.01, abs=0.01)
            assert yaw == pytest.approx(command.w * turning * SECONDS, rel=0.01, abs=0.01)
            assert measured[[0, 2]] == pytest.approx(SECONDS * np.array(command), rel=0.01, abs=0.01)
            if command.w:
                assert math.dist(start[:2], simulator.states[0].pose[:2]) < 0.01


def test_slip_spreads_as_stated(physics):
    """Over d metres a wheel slips with standard deviation slip_std * sqrt(d), which encoders do not measure."""
    robot = by_wheels(replace(BURGER, drive=replace(BURGER.drive, slip_std=0.02)))
    simulator = make_simulator(physics, robot, 0.1)
    headings, odometry_headings, runs = [], [], 60
    rng = np.random.default_rng(0)
    for _ in range(runs):
        simulator.reset(PLAIN, [ORIGIN], [rng])
        for _ in range(25):
            reading = simulator.step([Twist(0.2, 0.0)])[0]
        headings.append(simulator.states[0].pose.theta)
        odometry_headings.append(reading.odometry.theta)
    expected = math.sqrt(2.0) * 0.02 * math.sqrt(simulator.states[0].pose.x) / robot.drive.track
    assert np.std(headings) == pytest.approx(expected, rel=3.0 / math.sqrt(2 * runs))
    assert np.abs(odometry_headings).max() < 0.1 * expected


@pytest.mark.parametrize("command", [(1.0, 0.0), (0.0, 1.0), (1.0, -1.0), (0.02, 0.0)])
def test_no_slip_moves_a_robot_beyond_its_limits_and_their_margin(physics, command):
    robot = replace(BURGER, drive=replace(BURGER.drive, slip_std=1.0))
    forward, turning = gains(robot)
    more = 1.001 if physics == "kinematic" else 1.3  # a body with mass overshoots, and pitches
    margin = 0.1 * (1.0 + SLIP_MARGIN) * more
    twist = Twist(command[0] * robot.max_v, command[1] * robot.max_w)
    for motion, _ in motions(begin(physics, robot, PLAIN, ORIGIN), twist, 100):
        assert math.hypot(motion.x, motion.y) < margin * forward * robot.max_v
        assert abs(motion.theta) < margin * turning * robot.max_w


def test_the_control_period_changes_the_time_of_a_step_alone(physics):
    ends = []
    for period, steps in ((0.1, 30), (0.05, 60), (0.5, 6)):
        simulator = begin(physics, without_slip(BURGER), PLAIN, ORIGIN, period=period)
        for _ in range(steps):
            reading = simulator.step([Twist(0.2, 0.5)])[0]
        assert reading.time == pytest.approx(3.0)
        ends.append(simulator.states[0].pose)
    np.testing.assert_allclose(ends, [ends[0]] * 3, atol=2e-3)


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_random_commands_lead_to_the_same_pose_under_both_physics(bullet, name):
    """Within 2.5 cm, or 30 ms at full speed, and 0.03 rad, over 20 s, with up to 40 rad of turning."""
    robot = load_robot(name)
    metres_per_tick = 2 * math.pi * robot.drive.wheel_radius / robot.odometry.ticks_per_rev
    for seed in range(3):
        rng = np.random.default_rng(100 + seed)
        simulators = [begin(physics, robot, PLAIN, Pose2D(0.0, 0.0, 0.3), seed=seed) for physics in PHYSICS]
        for step in range(200):
            if step % 5 == 0:
                command = Twist(*rng.uniform([-robot.max_v, -robot.max_w], [robot.max_v, robot.max_w]))
            readings = [simulator.step([command])[0] for simulator in simulators]
            a, b = (simulator.states[0].pose for simulator in simulators)
            assert math.dist(a[:2], b[:2]) < max(0.025, 0.03 * robot.max_v)
            assert abs(wrap_angle(a.theta - b.theta)) < 0.03
            lag = np.abs(np.subtract(readings[0].ticks, readings[1].ticks)).max() * metres_per_tick
            assert lag < 0.01 + metres_per_tick

import math
from dataclasses import replace

import numpy as np
import pytest

from envs.estimation.motion import GyroMotion, WheelMotion, make_motion_source
from envs.geometry import Pose2D, wrap_angle
from envs.robots import load_robot
from envs.simulation import Reading, Twist, make_simulator
from envs.worlds import World

PERIOD = 0.1
WALLS = np.array([[-60, -60, 60, -60], [60, -60, 60, 60], [60, 60, -60, 60], [-60, 60, -60, -60]], dtype=float)
HALL = World("hall", WALLS, np.empty((0, 3)), (Pose2D(0.0, 0.0, 0.0),), (-60.0, -60.0, 60.0, 60.0))


@pytest.fixture
def robot():
    """Counts so fine that rounding does not show."""
    robot = load_robot("turtlebot3_burger")
    return replace(robot, odometry=replace(robot.odometry, ticks_per_rev=1e9))


def after(robot, left, right, yaw_rate=0.0, offset=(0, 0)):
    """The reading after the wheels have rolled these distances [m]."""
    per_metre = robot.odometry.ticks_per_rev / (2 * math.pi * robot.odometry.wheel_radius)
    ticks = round(left * per_metre) + offset[0], round(right * per_metre) + offset[1]
    return Reading(0.0, np.empty(0, dtype=np.float32), ticks, yaw_rate, math.nan, False)


@pytest.mark.parametrize("source", [WheelMotion, lambda robot: GyroMotion(robot, PERIOD)])
def test_straight_on(robot, source):
    odometry = source(robot)
    odometry.reset(after(robot, 0.0, 0.0, offset=(5, -7)))
    assert odometry.update(after(robot, 1.5, 1.5, offset=(5, -7))) == pytest.approx((1.5, 0.0, 0.0), abs=1e-6)
    assert odometry.update(after(robot, 1.5, 1.5, offset=(5, -7))) == (0.0, 0.0, 0.0)


def test_a_turn_on_the_spot_and_a_circle(robot):
    odometry = WheelMotion(robot)
    half = 0.5 * robot.odometry.track
    odometry.reset(after(robot, 0.0, 0.0))
    assert odometry.update(after(robot, -half * 0.3, half * 0.3)) == pytest.approx((0, 0, 0.3), abs=1e-6)
    odometry.reset(after(robot, 0.0, 0.0))
    quarter = math.pi / 2
    motion = odometry.update(after(robot, (1 - half) * quarter, (1 + half) * quarter))
    assert motion == pytest.approx((1.0, 1.0, quarter), abs=1e-6)


def test_turns_come_from_the_gyroscope_and_distances_from_the_wheels(robot):
    odometry = GyroMotion(robot, PERIOD)
    odometry.reset(after(robot, 0.0, 0.0))
    quarter = math.pi / 2
    # The left wheel spins; the arc of radius 1 m is as long as the wheels have rolled on average.
    motion = odometry.update(after(robot, quarter + 0.1, quarter - 0.1, yaw_rate=quarter / PERIOD))
    assert motion == pytest.approx((1.0, 1.0, quarter), abs=1e-6)


def test_the_robot_says_which_odometry_it_has(robot):
    wheels = replace(robot, odometry=replace(robot.odometry, uses_gyro=False))
    assert isinstance(make_motion_source(wheels, PERIOD), WheelMotion)
    gyro = replace(robot, odometry=replace(robot.odometry, uses_gyro=True))
    assert isinstance(make_motion_source(gyro, PERIOD), GyroMotion)


def test_the_gyroscope_halves_the_drift_of_heading_at_least():
    """Wheels that slip, over 5 min of driving; with the bias and noise of the library's robot."""
    robot = load_robot("turtlebot3_burger")
    sources = GyroMotion(robot, PERIOD), WheelMotion(robot)
    simulator = make_simulator("kinematic", robot, PERIOD)
    errors = []
    for seed in range(8):
        simulator.reset(HALL, [Pose2D(0.0, 0.0, 0.0)], [np.random.default_rng(seed)])
        reading, rng = simulator.step([Twist(0.0, 0.0)])[0], np.random.default_rng(seed)
        for source in sources:
            source.reset(reading)
        headings = np.zeros(2)
        for step in range(3000):
            if step % 30 == 0:
                command = Twist(0.2, rng.uniform(-1.0, 1.0))
            reading = simulator.step([command])[0]
            headings += [source.update(reading).theta for source in sources]
        errors.append([wrap_angle(heading - simulator.states[0].pose.theta) for heading in headings])
    gyro, wheels = np.sqrt(np.mean(np.square(errors), axis=0))
    assert gyro < 0.5 * wheels
    assert gyro < 300 * robot.imu.gyro_bias_std  # what the bias alone would make, had it not been measured at rest


def test_the_bias_is_estimated_while_the_wheels_rest_and_a_push_is_no_bias(robot):
    robot = replace(robot, imu=replace(robot.imu, gyro_std=0.001, gyro_bias_std=0.01))
    odometry = GyroMotion(robot, PERIOD)
    odometry.reset(after(robot, 0.0, 0.0, yaw_rate=0.02))
    for _ in range(50):
        odometry.update(after(robot, 0.0, 0.0, yaw_rate=0.02))
    assert odometry.update(after(robot, 0.0, 0.0, yaw_rate=0.02)).theta == pytest.approx(0.0, abs=1e-5)
    assert odometry.update(after(robot, 0.0, 0.0, yaw_rate=1.02)).theta == pytest.approx(PERIOD, abs=1e-5)
    assert odometry.update(after(robot, 0.1, 0.1, yaw_rate=0.02)).theta == pytest.approx(0.0, abs=1e-5)

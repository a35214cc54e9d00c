import math
from dataclasses import replace

import numpy as np
import pytest

from lidarnaut.envs.estimation.motion import GyroMotion, WheelMotion, make_motion_source
from lidarnaut.envs.geometry import wrap_angle
from lidarnaut.envs.simulation import Reading, Twist
from tests.rooms import BURGER, ORIGIN, PLAIN, begin

PERIOD = 0.1
ROBOT = replace(BURGER, odometry=replace(BURGER.odometry, ticks_per_rev=1e9))
"""Encoder resolution that makes rounding negligible."""


def after(left, right, yaw_rate=0.0, offset=(0, 0)):
    per_metre = ROBOT.odometry.ticks_per_rev / (2 * math.pi * ROBOT.odometry.wheel_radius)
    ticks = round(left * per_metre) + offset[0], round(right * per_metre) + offset[1]
    return Reading(0.0, np.empty(0, dtype=np.float32), ticks, yaw_rate, math.nan, False)


@pytest.mark.parametrize("source", [WheelMotion, lambda robot: GyroMotion(robot, PERIOD)])
def test_straight_on(source):
    odometry = source(ROBOT)
    odometry.reset(after(0.0, 0.0, offset=(5, -7)))
    assert odometry.update(after(1.5, 1.5, offset=(5, -7))) == pytest.approx((1.5, 0.0, 0.0), abs=1e-6)
    assert odometry.update(after(1.5, 1.5, offset=(5, -7))) == (0.0, 0.0, 0.0)


def test_a_turn_on_the_spot_and_a_circle():
    odometry = WheelMotion(ROBOT)
    half = 0.5 * ROBOT.odometry.track
    odometry.reset(after(0.0, 0.0))
    assert odometry.update(after(-half * 0.3, half * 0.3)) == pytest.approx((0, 0, 0.3), abs=1e-6)
    odometry.reset(after(0.0, 0.0))
    quarter = math.pi / 2
    motion = odometry.update(after((1 - half) * quarter, (1 + half) * quarter))
    assert motion == pytest.approx((1.0, 1.0, quarter), abs=1e-6)


def test_turns_come_from_the_gyroscope_and_distances_from_the_wheels():
    odometry = GyroMotion(ROBOT, PERIOD)
    odometry.reset(after(0.0, 0.0))
    quarter = math.pi / 2
    # The left wheel slips; the arc of radius 1 m has the mean length of both wheels.
    motion = odometry.update(after(quarter + 0.1, quarter - 0.1, yaw_rate=quarter / PERIOD))
    assert motion == pytest.approx((1.0, 1.0, quarter), abs=1e-6)


@pytest.mark.parametrize(("uses_gyro", "kind"), [(False, WheelMotion), (True, GyroMotion)])
def test_the_robot_says_which_odometry_it_has(uses_gyro, kind):
    robot = replace(ROBOT, odometry=replace(ROBOT.odometry, uses_gyro=uses_gyro))
    assert isinstance(make_motion_source(robot, PERIOD), kind)


def test_the_gyroscope_halves_the_drift_of_heading_at_least():
    """With wheel slip over 5 min of driving, and bias and noise of the library's robot."""
    sources = GyroMotion(BURGER, PERIOD), WheelMotion(BURGER)
    errors = []
    for seed in range(8):
        simulator = begin("kinematic", BURGER, PLAIN, ORIGIN, seed=seed)
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
    assert gyro < 300 * BURGER.imu.gyro_bias_std  # drift by the bias, without calibration at rest


def test_the_bias_is_estimated_while_the_wheels_rest_and_a_push_is_no_bias():
    imu = replace(ROBOT.imu, gyro_std=0.001, gyro_bias_std=0.01)
    odometry = GyroMotion(replace(ROBOT, imu=imu), PERIOD)
    odometry.reset(after(0.0, 0.0, yaw_rate=0.02))
    for _ in range(50):
        odometry.update(after(0.0, 0.0, yaw_rate=0.02))
    assert odometry.update(after(0.0, 0.0, yaw_rate=0.02)).theta == pytest.approx(0.0, abs=1e-5)
    assert odometry.update(after(0.0, 0.0, yaw_rate=1.02)).theta == pytest.approx(PERIOD, abs=1e-5)
    assert odometry.update(after(0.1, 0.1, yaw_rate=0.02)).theta == pytest.approx(0.0, abs=1e-5)

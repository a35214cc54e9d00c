import math
from dataclasses import replace

import pytest

from lidarnaut.envs.simulation.odometry import update_odometry
from lidarnaut.envs.simulation.rows import Rows
from tests.rooms import BURGER, ORIGIN

PERIOD = 0.1
ROBOT = replace(BURGER, odometry=replace(BURGER.odometry, ticks_per_rev=1e9, uses_gyro=False))
"""Encoder resolution that makes rounding negligible."""
WITH_GYRO = replace(ROBOT, odometry=replace(ROBOT.odometry, uses_gyro=True))
QUARTER = math.pi / 2


class Odometry:
    """Odometry of a robot whose wheels have travelled some distances [m] since the reset."""

    def __init__(self, robot, yaw_rate=0.0, offset=(0, 0)):
        self.rows, self.robot, self.offset = Rows(robot, PERIOD, 1), robot, offset
        self.update(0.0, 0.0, yaw_rate, steps=0)

    def update(self, left, right, yaw_rate=0.0, steps=1):
        """Return the next reading."""
        self.rows.go_to(steps and self.rows.steps + 1)
        row, per_metre = self.rows.numbers[0], 1.0 / self.robot.odometry.metres_per_tick
        row["yaw_rate"] = yaw_rate
        update_odometry(row, round(left * per_metre) + self.offset[0], round(right * per_metre) + self.offset[1])
        return self.rows.reading(0)


@pytest.mark.parametrize("robot", [ROBOT, WITH_GYRO])
def test_straight_on(robot):
    odometry = Odometry(robot, offset=(5, -7))
    assert odometry.update(1.5, 1.5).motion == pytest.approx((1.5, 0.0, 0.0), abs=1e-6)
    reading = odometry.update(1.5, 1.5)
    assert reading.motion == ORIGIN
    assert reading.odometry == pytest.approx((1.5, 0.0, 0.0), abs=1e-6)


def test_a_turn_on_the_spot_and_a_circle():
    half = 0.5 * ROBOT.odometry.track
    assert Odometry(ROBOT).update(-half * 0.3, half * 0.3).motion == pytest.approx((0, 0, 0.3), abs=1e-6)
    motion = Odometry(ROBOT).update((1 - half) * QUARTER, (1 + half) * QUARTER).motion
    assert motion == pytest.approx((1.0, 1.0, QUARTER), abs=1e-6)


def test_turns_come_from_the_gyroscope_and_distances_from_the_wheels():
    # The left wheel slips; the arc of radius 1 m has the mean length of both wheels.
    motion = Odometry(WITH_GYRO).update(QUARTER + 0.1, QUARTER - 0.1, QUARTER / PERIOD).motion
    assert motion == pytest.approx((1.0, 1.0, QUARTER), abs=1e-6)


def test_poses_sum_up_motions_and_motions_span_several_readings():
    odometry = Odometry(WITH_GYRO)
    first = odometry.update(0.1, 0.1, 0.3)
    second = odometry.update(0.3, 0.3, -0.8)
    third = odometry.update(0.3, 0.4, 1.1)
    assert third.odometry == ORIGIN.compose(first.motion).compose(second.motion).compose(third.motion)
    assert third.motion_since(second.odometry) is third.motion
    expected = second.motion.compose(third.motion)
    assert third.motion_since(first.odometry) == pytest.approx(expected, abs=1e-12)
    assert second.motion_since(second.odometry) == pytest.approx(ORIGIN, abs=1e-12)


def test_the_bias_is_estimated_while_the_wheels_rest_and_a_push_is_no_bias():
    imu = replace(ROBOT.imu, gyro_std=0.001, gyro_bias_std=0.01)
    odometry = Odometry(replace(WITH_GYRO, imu=imu), yaw_rate=0.02)
    for _ in range(50):
        odometry.update(0.0, 0.0, 0.02)
    assert odometry.update(0.0, 0.0, 0.02).motion.theta == pytest.approx(0.0, abs=1e-5)
    assert odometry.update(0.0, 0.0, 1.02).motion.theta == pytest.approx(PERIOD, abs=1e-5)
    assert odometry.update(0.1, 0.1, 0.02).motion.theta == pytest.approx(0.0, abs=1e-5)

import math

import pytest

from envs.robots import ROBOT_NAMES, OdometryNoise, load_robot

DISTANCE, TURN = 0.2, 0.3
"""Motion between two key scans [m], [rad]."""


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_noise_in_the_library_follows_from_what_is_simulated(name):
    robot = load_robot(name)
    drive, odometry, imu, noise = robot.drive, robot.odometry, robot.imu, robot.odometry.noise
    position = noise.position_std + noise.position_per_metre * DISTANCE
    straight = noise.heading_std + noise.heading_per_metre * DISTANCE
    turning = noise.heading_std + noise.heading_per_radian * TURN
    # Each wheel slips by slip_std times the root of the distance that it rolls; the base moves by their mean.
    slip = drive.slip_std * math.sqrt(DISTANCE / 2)
    scale = drive.wheel_radius / odometry.wheel_radius
    assert slip <= position <= 3 * slip + 1.1 * DISTANCE * abs(scale - 1.0) + 0.001
    if odometry.uses_gyro:
        drift = imu.gyro_bias_std * DISTANCE / robot.max_v
        assert drift <= straight <= 0.002
    else:
        expected = drive.slip_std * math.sqrt(2 * DISTANCE) / drive.track
        assert expected <= straight <= 2 * expected
        bias = TURN * abs(scale * odometry.track / drive.track - 1.0)
        slipped = drive.slip_std * math.sqrt(TURN / drive.track)
        assert math.hypot(slipped, bias) <= turning <= 2 * (slipped + bias)


def test_noise_is_never_zero():
    with pytest.raises(ValueError, match=r"heading_std\n.*greater than 0"):
        OdometryNoise(heading_std=0.0)
    with pytest.raises(ValueError, match=r"position_per_metre\n.*greater than or equal to 0"):
        OdometryNoise(position_per_metre=-0.1)

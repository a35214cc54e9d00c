import math

import pytest

from lidarnaut.envs.robots import ROBOT_NAMES, load_robot

DISTANCE, TURN = 0.2, 0.3
"""Motion between two key scans [m], [rad]."""


def reach(robot):
    """Distance from the axle's midpoint to the farthest point of body, wheels and casters."""
    body, drive = robot.body, robot.drive
    x, y, _ = body.center
    if body.size is None:
        farthest = math.hypot(x, y) + body.radius
    else:
        farthest = math.hypot(abs(x) + body.size[0] / 2, abs(y) + body.size[1] / 2)
    wheel = math.hypot(drive.wheel_radius, (drive.track + drive.wheel_width) / 2)
    return max(farthest, wheel, *(math.hypot(caster.x, caster.y) for caster in robot.casters))


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_every_robot_is_whole(name):
    robot = load_robot(name)
    assert robot.name == name
    assert len(robot.source) > 20
    assert reach(robot) <= robot.radius < 1.1 * reach(robot), "the footprint must hold the body, and not much more"
    assert robot.casters, "a body on two wheels falls over"
    assert robot.lidar.mount.z > 0
    assert 0 < robot.drive.slip_std < 0.01


def test_gyroscopes_biases_and_lidars_are_as_documented():
    fusing = {name for name in ROBOT_NAMES if load_robot(name).odometry.uses_gyro}
    assert fusing == {"turtlebot3_burger", "turtlebot3_waffle_pi", "turtlebot3_waffle_pi_x3", "create3", "jackal"}
    assert all(load_robot(name).imu.gyro_bias_std > 0 for name in fusing)
    mouse = load_robot("raspimouse")
    assert mouse.odometry.open_loop
    assert mouse.drive.wheel_radius / mouse.odometry.wheel_radius == pytest.approx(48 / 45)
    assert mouse.odometry.track / mouse.drive.track == pytest.approx(90 / 92.5)
    original = load_robot("tugbot_original")
    assert (original.odometry.track, original.drive.track) == (0.5605, 0.514)
    assert load_robot("tugbot").drive.track == 0.514
    for robot in map(load_robot, set(ROBOT_NAMES) - {"raspimouse", "tugbot_original"}):
        assert robot.odometry.track == robot.drive.track
        assert robot.odometry.wheel_radius == robot.drive.wheel_radius


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_noise_in_the_library_follows_from_what_is_simulated(name):
    robot = load_robot(name)
    drive, odometry, imu, noise = robot.drive, robot.odometry, robot.imu, robot.odometry.noise
    position = noise.position_std + noise.position_per_metre * DISTANCE
    straight = noise.heading_std + noise.heading_per_metre * DISTANCE
    turning = noise.heading_std + noise.heading_per_radian * TURN
    # Each wheel slips by slip_std times the root of its rolled distance; the base moves by the mean of both.
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

import math

import pytest

from envs.robots import ROBOT_NAMES, load_robot


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


def test_robots_whose_makers_fuse_the_gyroscope_into_odometry():
    fusing = {name for name in ROBOT_NAMES if load_robot(name).odometry.uses_gyro}
    assert fusing == {"turtlebot3_burger", "turtlebot3_waffle_pi", "create3"}
    assert all(load_robot(name).imu.gyro_bias_std > 0 for name in fusing)


def test_documented_biases():
    mouse = load_robot("raspimouse")
    assert mouse.odometry.open_loop
    assert mouse.drive.wheel_radius / mouse.odometry.wheel_radius == pytest.approx(48 / 45)
    assert mouse.odometry.track / mouse.drive.track == pytest.approx(90 / 92.5)
    original, corrected = load_robot("tugbot_original"), load_robot("tugbot")
    assert (original.odometry.track, original.drive.track) == (0.5605, 0.514)
    assert corrected.odometry.track == corrected.drive.track == 0.514
    unbiased = set(ROBOT_NAMES) - {"raspimouse", "tugbot_original"}
    for name in unbiased:
        robot = load_robot(name)
        assert robot.odometry.track == robot.drive.track
        assert robot.odometry.wheel_radius == robot.drive.wheel_radius


def test_lidars_are_as_documented():
    assert (load_robot("turtlebot3_burger").lidar.range_min, load_robot("turtlebot3_burger").lidar.range_max) == (
        0.12,
        3.5,
    )
    tugbot = load_robot("tugbot").lidar
    assert (tugbot.range_min, tugbot.range_max, tugbot.num_beams) == (0.6, 10.0, 360)
    scanner = load_robot("mpo_500").lidar
    assert (scanner.range_min, scanner.range_max) == (0.5, 50.0)
    assert math.degrees(scanner.fov) == pytest.approx(270)
    assert math.degrees(scanner.angle_increment) == pytest.approx(0.25)

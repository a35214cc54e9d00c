import dataclasses
import math
import pickle

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.navigation import Navigator, free_distance
from lidarnaut.envs.navigation.controllers.navigator_kernels import DRIVING, FAILED
from lidarnaut.envs.navigation.maps.obstacles import BUMP_POINTS
from lidarnaut.envs.robots import Mount, load_robot
from lidarnaut.envs.simulation import Twist
from tests.baselines.maps import reading_of

BURGER = load_robot("turtlebot3_burger")


def robot_with(**lidar):
    return dataclasses.replace(BURGER, lidar=dataclasses.replace(BURGER.lidar, **lidar))


def scan_of(robot, pose, points):
    """Scan of single points (world frame); each point fills the nearest beam."""
    lidar = robot.lidar
    sensor = pose.compose(Pose2D(lidar.mount.x, lidar.mount.y, lidar.mount.yaw))
    ranges = np.full(lidar.num_beams, np.inf, dtype=np.float32)
    for x, y, _ in (sensor.between(Pose2D(*point, 0.0)) for point in points):
        distance, bearing = math.hypot(x, y), math.atan2(y, x)
        beam = round((bearing - lidar.angle_min) / lidar.angle_increment) % lidar.num_beams
        if abs(bearing) <= lidar.fov / 2 and distance < lidar.range_max:
            ranges[beam] = distance if distance >= lidar.range_min else np.nan
    return ranges


class Wheels:
    """Readings of a robot that drives at a speed [m/s] and a yaw rate [rad/s] for 0.1 s each."""

    def __init__(self, robot):
        self.robot, self.pose = robot, Pose2D(0.0, 0.0, 0.0)

    def drive(self, v, w, points, *, bumper=False):
        length, dtheta = 0.1 * v, 0.1 * w
        motion = Pose2D(length * math.cos(dtheta / 2), length * math.sin(dtheta / 2), dtheta)
        self.pose = self.pose.compose(motion)
        ranges = scan_of(self.robot, self.pose, points)
        reading = reading_of(ranges=ranges, bumper=bumper, robot=self.robot)
        return reading._replace(motion=motion, odometry=self.pose)


def begin(robot, points):
    navigator, wheels = Navigator(robot, 0.1), Wheels(robot)
    navigator.sense(wheels.drive(0.0, 0.0, points))
    return navigator, wheels


def test_motion_covers_readings_that_a_policy_skips():
    navigator, wheels = begin(BURGER, [])
    skipped = wheels.drive(0.2, 0.5, []).motion
    last = wheels.drive(0.1, -1.5, [])
    navigator.sense(last)
    assert navigator.motion == pytest.approx(skipped.compose(last.motion), abs=1e-12)


def test_what_comes_too_near_is_remembered_until_it_is_seen_again():
    robot = robot_with(range_min=0.6, num_beams=3600, mount=Mount())
    wall = [(1.0, y) for y in np.linspace(-0.2, 0.2, 9)]
    navigator, wheels = begin(robot, wall)
    for share in 30 * [1.0] + 5 * [0.0] + 50 * [-1.0]:
        navigator.sense(wheels.drive(share * robot.max_v, 0.3 * share * robot.max_w, wall))
        found = navigator.obstacles
        inside = np.array([wheels.pose.between(Pose2D(*point, 0.0))[:2] for point in wall])
        gaps = np.hypot(found[:, None, 0] - inside[:, 0], found[:, None, 1] - inside[:, 1])
        # Each point of the wall is in memory all the time, without false points.
        assert gaps.min(axis=0).max() < 0.03
        assert gaps.min(axis=1).max() < 0.03


def test_what_leaves_the_view_is_remembered():
    robot = robot_with(fov=math.pi)
    pole = [(0.0, 0.4)]
    navigator, wheels = begin(robot, pole)
    for _ in range(7):
        navigator.sense(wheels.drive(0.0, -robot.max_w, pole))
        assert len(navigator.obstacles) == 1
        np.testing.assert_allclose(wheels.pose.transform(navigator.obstacles)[0], pole[0], atol=0.02)


def test_a_bump_leaves_an_obstacle_where_the_robot_drove():
    robot = robot_with(range_min=0.3)
    for sign in (1.0, -1.0):
        navigator, wheels = begin(robot, [])
        navigator.note_command(Twist(sign * robot.max_v, 0.0))
        navigator.sense(wheels.drive(0.0, 0.0, [], bumper=True))
        assert len(navigator.obstacles) > 0
        assert (sign * navigator.obstacles[:, 0] > 0.8 * robot.radius).all()


def test_a_contact_that_lasts_is_marked_once():
    robot = robot_with(range_min=0.3)
    navigator, wheels = begin(robot, [])
    for _ in range(40):
        navigator.sense(wheels.drive(0.0, 1.0, [], bumper=True))
    assert len(navigator.obstacles) == BUMP_POINTS


def test_contacts_are_forgotten_when_a_drive_has_failed():
    robot = robot_with(range_min=0.3)
    pose = Pose2D(0.0, 0.0, 0.0)
    navigator, wheels = begin(robot, [(0.35, 0.0)])
    navigator.sense(wheels.drive(1.0, 0.0, [(0.35, 0.0)]))  # now 0.25 m ahead, below the minimum range
    navigator.drive_to(np.array([[0.0, 0.0], [2.0, 0.0]]))
    progress, most = DRIVING, 0
    while progress == DRIVING:
        navigator.command(pose)
        progress = navigator.update(wheels.drive(0.0, 0.0, [], bumper=True), pose)
        most = max(most, len(navigator.obstacles))
    assert progress == FAILED
    assert most >= 6  # contacts ahead or all around, and the obstacle
    np.testing.assert_allclose(navigator.obstacles, [[0.25, 0.0]], atol=0.01)


def test_a_copy_stops_by_itself():
    navigator, _ = begin(BURGER, [])
    navigator.drive_to(np.array([[0.0, 0.0], [1.0, 0.0]]))
    twin = pickle.loads(pickle.dumps(navigator))
    twin.stop()
    assert twin.command(Pose2D(0.0, 0.0, 0.0)) == Twist(0.0, 0.0)
    assert navigator.command(Pose2D(0.0, 0.0, 0.0)).v > 0.0


def reference_free_distance(points, curvature, radius, distance, graze=0.0):
    """Free distance by rolling a pose along the arc in steps of 0.5 mm; overlaps less than `graze` are ignored."""
    start = np.hypot(*points.T)
    for along in np.arange(5e-4, abs(distance), 5e-4):
        s = math.copysign(along, distance)
        pose = Pose2D(s * np.sinc(s * curvature / math.pi), s * math.sin(s * curvature / 2), 0.0)
        if abs(curvature) > 1e-9:
            pose = Pose2D(math.sin(s * curvature) / curvature, (1 - math.cos(s * curvature)) / curvature, 0.0)
        gaps = np.hypot(*(points - pose[:2]).T)
        if ((gaps < radius - graze) & (gaps < start - 1e-3 - graze)).any():
            return along
    return abs(distance)


@settings(max_examples=25, deadline=None)
@example(0.0, -0.6, 227)  # a point that comes 1 mm nearer over 7 mm of the arc
@given(st.floats(-6.0, 6.0), st.sampled_from([-0.6, 0.3, 1.0]), st.integers(0, 2**32 - 1))
def test_free_distance_equals_rolling_along(curvature, distance, seed):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1.2, 1.2, (4, 2))
    points = points[np.hypot(*points.T) > 0.1]  # not below the middle of the robot
    found = free_distance(points, curvature, 0.2, distance)
    # Never too long, except for a graze between two steps; at most one step too short.
    assert found <= reference_free_distance(points, curvature, 0.2, distance, graze=5e-4) + 0.021
    assert found >= reference_free_distance(points, curvature, 0.2, distance) - 0.021

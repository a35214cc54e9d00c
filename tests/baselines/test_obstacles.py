"""Obstacles near the robot: what is remembered, and how far an arc is free."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from baselines.obstacles import ObstacleMemory
from envs.geometry import Pose2D
from envs.navigation import free_distance
from envs.robots import Mount, load_robot

BURGER = load_robot("turtlebot3_burger")


def robot_with(**lidar):
    return dataclasses.replace(BURGER, lidar=dataclasses.replace(BURGER.lidar, **lidar))


def scan_of(robot, pose, points):
    """The beams that would hit lone points in the world, seen from a pose; each point fills the beam nearest to it."""
    lidar = robot.lidar
    sensor = pose.compose(Pose2D(lidar.mount.x, lidar.mount.y, lidar.mount.yaw))
    scan = np.ones(lidar.num_beams, dtype=np.float32)
    for x, y, _ in (sensor.between(Pose2D(*point, 0.0)) for point in points):
        distance, bearing = math.hypot(x, y), math.atan2(y, x)
        beam = round((bearing - lidar.angle_min) / lidar.angle_increment) % lidar.num_beams
        if abs(bearing) <= lidar.fov / 2 and distance < lidar.range_max:
            scan[beam] = distance / lidar.range_max if distance >= lidar.range_min else 0.0
    return scan


def test_scan_ends_lie_where_the_lidar_saw_them():
    robot = robot_with(mount=Mount(x=0.2, y=-0.1, yaw=math.pi / 2), range_min=0.0)
    points = [(1.2, -0.1), (0.2, 0.9), (-0.8, -0.1), (0.2, -1.1)]
    scan = scan_of(robot, Pose2D(0.0, 0.0, 0.0), points)
    found = ObstacleMemory(robot, 0.1).update(scan, np.zeros(6, dtype=np.float32))
    assert sorted(map(tuple, found.round(6))) == sorted(points)


def test_what_comes_too_near_is_remembered_until_it_is_seen_again():
    robot = robot_with(range_min=0.6, num_beams=3600, mount=Mount())
    memory = ObstacleMemory(robot, 0.1)
    wall = [(1.0, y) for y in np.linspace(-0.2, 0.2, 9)]
    pose = Pose2D(0.0, 0.0, 0.0)
    motion = np.zeros(6, dtype=np.float32)
    for command in [0.0] + 30 * [1.0] + 5 * [0.0] + 50 * [-1.0]:
        motion[:3] = command, 0.3 * command, command
        dtheta = motion[1] * robot.max_w * 0.1
        step = motion[0] * robot.max_v * 0.1
        pose = pose.compose(Pose2D(step * math.cos(dtheta / 2), step * math.sin(dtheta / 2), dtheta))
        found = memory.update(scan_of(robot, pose, wall), motion)
        inside = np.array([pose.between(Pose2D(*point, 0.0))[:2] for point in wall])
        gaps = np.hypot(found[:, None, 0] - inside[:, 0], found[:, None, 1] - inside[:, 1])
        # Each point of the wall is known all the time, and nothing else is.
        assert gaps.min(axis=0).max() < 0.03
        assert gaps.min(axis=1).max() < 0.03


def test_what_leaves_the_view_is_remembered():
    robot = robot_with(fov=math.pi)
    memory = ObstacleMemory(robot, 0.1)
    pole = [(0.0, 0.4)]
    motion = np.zeros(6, dtype=np.float32)
    memory.update(scan_of(robot, Pose2D(0.0, 0.0, 0.0), pole), motion)
    motion[1] = -1.0
    for k in range(1, 8):
        pose = Pose2D(0.0, 0.0, -k * robot.max_w * 0.1)
        found = memory.update(scan_of(robot, pose, pole), motion)
        assert len(found) == 1
        np.testing.assert_allclose(pose.transform(found)[0], pole[0], atol=0.02)


def test_a_bump_leaves_an_obstacle_where_the_robot_drove():
    robot = robot_with(range_min=0.3)
    scan, motion = np.ones(360, dtype=np.float32), np.zeros(6, dtype=np.float32)
    motion[4] = 1.0
    for command, sign in ((1.0, 1.0), (-1.0, -1.0)):
        motion[2] = command
        found = ObstacleMemory(robot, 0.1).update(scan, motion)
        assert len(found) > 0
        assert (sign * found[:, 0] > 0.8 * robot.radius).all()


def reference_free_distance(points, curvature, radius, distance):
    """The same in steps of half a millimetre, by rolling a pose along the arc."""
    start = np.hypot(*points.T)
    for along in np.arange(5e-4, abs(distance), 5e-4):
        s = math.copysign(along, distance)
        pose = Pose2D(s * np.sinc(s * curvature / math.pi), s * math.sin(s * curvature / 2), 0.0)
        if abs(curvature) > 1e-9:
            pose = Pose2D(math.sin(s * curvature) / curvature, (1 - math.cos(s * curvature)) / curvature, 0.0)
        gaps = np.hypot(*(points - pose[:2]).T)
        if ((gaps < radius) & (gaps < start - 1e-3)).any():
            return along
    return abs(distance)


@settings(max_examples=25, deadline=None)
@given(st.floats(-6.0, 6.0), st.sampled_from([-0.6, 0.3, 1.0]), st.integers(0, 2**32 - 1))
def test_free_distance_equals_rolling_along(curvature, distance, seed):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1.2, 1.2, (4, 2))
    expected = reference_free_distance(points, curvature, 0.2, distance)
    found = free_distance(points, curvature, 0.2, distance)
    # Never too far, but for a graze between two tests; at most one step of the test too short.
    assert found <= expected + 0.021
    assert found >= expected - 0.021


def test_a_touching_point_stops_only_what_approaches_it():
    behind = np.array([[-0.15, 0.0]])
    assert free_distance(behind, 0.0, 0.2, 0.5) == pytest.approx(0.5)
    assert free_distance(behind, 0.0, 0.2, -0.5) == 0.0
    assert free_distance(np.empty((0, 2)), 1.0, 0.2, 0.5) == pytest.approx(0.5)

"""Worlds of so many walls that PyBullet holds those around the robots alone."""

import math
from dataclasses import replace

import numpy as np
import pytest

from envs.geometry import Pose2D
from envs.robots import load_robot
from envs.simulation import Twist, make_simulator
from envs.worlds import load_world
from tests.rooms import BURGER, make_room

pytest.importorskip("pybullet")

from envs.simulation import bullet_world
from envs.simulation.bullet_world import NearbyWalls


@pytest.fixture
def many(monkeypatch):
    """Let every world count as one with many walls."""
    monkeypatch.setattr(bullet_world, "_MANY", 0)


def corridor(length):
    """A corridor of 1 m along x, of walls of a tenth of a metre, closed at both ends."""
    sides = [[x, y, x + 0.1, y] for y in (-0.5, 0.5) for x in np.arange(0.0, length, 0.1)]
    ends = [[x, -0.5, x, 0.5] for x in (0.0, length)]
    bodies = {"segments": np.array(sides + ends), "circles": np.array([[length - 1.0, 0.4, 0.1]])}
    return replace(make_room(0.0, -0.5, length, 0.5, spawn=Pose2D(0.5, 0.0, 0.0)), **bodies)


def drive(simulator, world, commands, seed=0):
    simulator.reset(world, [world.spawns[0]], [np.random.default_rng(seed)])
    readings = [simulator.step([command])[0] for command in commands]
    return simulator.states[0].pose, readings[-1]


def test_a_robot_far_from_its_start_is_stopped_by_walls(many):
    robot = load_robot("create3")
    simulator = make_simulator("bullet", robot, 0.2)
    length = 14.0
    pose, reading = drive(simulator, corridor(length), [Twist(robot.max_v, 0.0)] * 300)
    assert length / 2 < pose.x < length - robot.radius + 0.02
    assert abs(pose.y) < 0.5 - robot.radius + 0.02
    assert reading.bumper


def test_an_episode_does_not_depend_on_the_one_before(many):
    world, rng = load_world("turtlebot3_house"), np.random.default_rng(1)
    commands = [Twist(BURGER.max_v, float(w)) for w in rng.uniform(-1.0, 1.0, 60).repeat(5)]
    first, again = (make_simulator("bullet", BURGER, 0.2) for _ in range(2))
    drive(again, world, commands[::-1], seed=5)
    poses = [drive(simulator, world, commands)[0] for simulator in (first, again, again)]
    assert poses[0] == poses[1] == poses[2]


def test_what_is_near_is_there_and_what_is_far_is_not(many):
    """Along a drive of 30 m, no wall in reach is missing, and the meshes of old walls are gone."""
    shapes = {}

    class Client:
        GEOM_MESH = GEOM_FORCE_CONCAVE_TRIMESH = GEOM_CONCAVE_INTERNAL_EDGE = 0

        def createCollisionShape(self, _, vertices, **__):
            shapes[number := max(shapes, default=0) + 1] = np.array(vertices)[:, :2]
            return number

        def createMultiBody(self, _, shape):
            return shape

        def removeBody(self, shape):
            del shapes[shape]

        def setCollisionFilterGroupMask(self, *_): ...

        def changeDynamics(self, *_, **__): ...

    world, reach = corridor(30.0), 0.7
    walls = NearbyWalls(Client(), world, reach)
    for x in np.arange(0.5, 29.5, 0.1):
        walls.follow(np.array([[x, 0.0]]))
        (built,) = shapes.values()
        starts = {tuple(np.round(point, 3)) for point in built}
        for x0, y0, x1, _ in world.segments:
            if math.hypot(max(x0 - x, x - x1, 0.0), y0) < reach:
                assert (round(x0, 3), round(y0, 3)) in starts
        assert np.abs(built[:, 0] - x).max() < 5.0

from dataclasses import replace

import numpy as np

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.simulation import make_simulator
from lidarnaut.envs.worlds import World

ORIGIN = Pose2D(0.0, 0.0, 0.0)
BURGER = load_robot("turtlebot3_burger")


def make_room(x_min, y_min, x_max, y_max, segments=(), circles=(), people=(), spawn=ORIGIN):
    """The walls of the room come before `segments`."""
    corners = [(x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max)]
    walls = [(*a, *b) for a, b in zip(corners, corners[1:] + corners[:1])]
    return World(
        name="test",
        segments=np.array([*walls, *segments], dtype=float),
        circles=np.array(circles, dtype=float).reshape(-1, 3),
        spawns=(spawn,),
        bounds=(x_min, y_min, x_max, y_max),
        people=tuple(people),
    )


def square_room(size, segments=(), circles=(), people=()):
    """Room of side 2 `size` around the origin."""
    return make_room(-size, -size, size, size, segments, circles, people)


def hall(width=8.0, height=4.0, segments=()):
    """Room with its lower left corner at the origin; the robot starts near the corner."""
    return make_room(0.0, 0.0, width, height, segments, spawn=Pose2D(0.4, 0.4, 0.0))


PLAIN = square_room(60.0)


def without_slip(robot):
    return replace(robot, drive=replace(robot.drive, slip_std=0.0))


def begin(physics, robot, world, *poses, period=0.1, seed=0):
    """Return a simulator at the start of an episode of robots at `poses`."""
    simulator = make_simulator(physics, robot, period, len(poses))
    simulator.reset(world, poses, np.random.default_rng(seed).spawn(len(poses)))
    return simulator


def tilt_of(simulator):
    """Return the larger of absolute roll and pitch of the first robot in PyBullet [rad]."""
    bullet, body = simulator.robots[0]._bullet, simulator.robots[0]._body
    roll, pitch, _ = bullet.getEulerFromQuaternion(bullet.getBasePositionAndOrientation(body)[1])
    return max(abs(roll), abs(pitch))

"""Robots that drive into walls at full speed, in every world and under both physics."""

import math
from dataclasses import dataclass, replace

import numpy as np

from envs.arguments import choose_robot
from envs.geometry import Pose2D
from envs.robots import load_robot
from envs.simulation import Twist, make_simulator
from envs.worlds import World, explorable_area, load_world

PERIOD = 0.2
"""Control period [s]."""
BURST = 8
"""Control periods with the same command."""
STARTS = 10
"""Random starts in a world."""
TOLERANCE = 1.1
"""Speed over the robot's greatest that wheel slip explains."""
SLACK = 0.02
"""Distance beyond it by which a wall may push a robot out in a control period [m]."""


@dataclass
class Drive:
    """What happened on a drive."""

    world: str
    physics: str
    steps: int = 0
    contacts: int = 0
    """Control periods that ended in contact."""
    through: int = 0
    """Control periods in which the base crossed a wall."""
    too_fast: int = 0
    """Control periods in which it moved farther than its greatest speed allows."""


def drive(world_name: str, physics: str, steps: int, seed: int) -> Drive:
    """Drive at full speed in random directions, from ten random starts; movers of the world are left out.

    What pushes robots aside makes them faster than their limits, so that worlds are driven without what moves.
    """
    world = replace(load_world(world_name), movers=())
    robot = choose_robot(None, world_name)
    rng = np.random.default_rng([seed, len(world.segments)])
    area = explorable_area(world, robot, 0.005 if robot.radius < 0.1 else 0.05)  # for corridors of 0.18 m
    simulator = make_simulator(physics, robot, PERIOD)
    fastest = robot.max_v * robot.drive.wheel_radius / robot.odometry.wheel_radius
    result = Drive(world_name, physics)
    for _ in range(STARTS):
        pose = area.draw_pose(rng)
        simulator.reset(world, [pose], [rng])
        for k in range(math.ceil(steps / STARTS)):
            if k % BURST == 0:
                command = Twist(robot.max_v * rng.choice([-1.0, 1.0]), robot.max_w * rng.choice([-1.0, 0.0, 0.0, 1.0]))
            reading = simulator.step([command])[0]
            before, pose = pose, simulator.states[0].pose
            moved = math.hypot(pose.x - before.x, pose.y - before.y)
            result.steps += 1
            result.contacts += bool(reading.bumper)
            result.through += crosses(before, pose, world.segments)
            result.too_fast += moved > TOLERANCE * fastest * PERIOD + SLACK
    simulator.close()
    return result


def slide(robot_name: str, physics: str, angle: float) -> float:
    """Return how far a robot gets along a wall in ten seconds at full speed, heading into it at an angle [deg] [m]."""
    robot = load_robot(robot_name)
    start = Pose2D(0.0, -robot.radius - 0.01, math.radians(angle))
    wall = np.array([[-20.0, 0.0, 20.0, 0.0]])
    world = World("wall", wall, np.empty((0, 3)), spawns=(start,), bounds=(-20.0, -20.0, 20.0, 0.0))
    simulator = make_simulator(physics, robot, PERIOD)
    simulator.reset(world, [start], [np.random.default_rng(0)])
    for _ in range(round(10.0 / PERIOD)):
        simulator.step([Twist(robot.max_v, 0.0)])
    x = simulator.states[0].pose.x
    simulator.close()
    return x


def crosses(before: Pose2D, after: Pose2D, segments: np.ndarray) -> bool:
    """Tell whether the line between two positions crosses one of some segments, shape (n, 4) [m]."""
    a, b = np.array(before[:2]), np.array(after[:2])
    c, d = segments[:, :2], segments[:, 2:]
    sides = _side(a, b, c) * _side(a, b, d), _side(c, d, a) * _side(c, d, b)
    return bool(((sides[0] < 0.0) & (sides[1] < 0.0)).any())


def _side(a: np.ndarray, b: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return on which side of the line from a to b a point lies: the sign of the cross product."""
    ab, ap = b - a, p - a
    return np.sign(ab[..., 0] * ap[..., 1] - ab[..., 1] * ap[..., 0])

"""What robots touch."""

import numpy as np
import pytest

from envs.geometry import Pose2D
from envs.robots import load_robot
from envs.simulation import KinematicSimulator, Twist, make_simulator
from envs.worlds import World
from envs.worlds.world import Mover

ROBOT = load_robot("turtlebot3_burger")


def hall(circles=(), movers=()):
    corners = [(0.0, 0.0), (6.0, 0.0), (6.0, 4.0), (0.0, 4.0)]
    segments = np.array([[*a, *b] for a, b in zip(corners, [*corners[1:], corners[0]])])
    circles = np.array(circles, dtype=np.float64).reshape(-1, 3)
    return World("hall", segments, circles, (Pose2D(1, 2, 0),), (0.0, 0.0, 6.0, 4.0), tuple(movers))


def drive(simulator, world, poses, twists, seconds=20.0):
    simulator.reset(world, poses, [np.random.default_rng(k) for k in range(len(poses))])
    assert list(simulator.contacts) == []
    for _ in range(round(10 * seconds)):
        simulator.step(twists)
        if simulator.contacts:
            return simulator.contacts
    return []


@pytest.mark.parametrize("physics", ["kinematic", "bullet"])
def test_a_contact_says_what_was_touched(physics):
    if physics == "bullet":
        pytest.importorskip("pybullet")
    ahead = [Twist(0.2, 0.0)]
    walls = drive(make_simulator(physics, ROBOT, 0.1), hall(), [Pose2D(5.0, 2.0, 0.0)], ahead)
    assert walls == [(0, "wall", 1)]
    post = hall(circles=[(1.0, 1.0, 0.1), (4.0, 2.0, 0.2)])
    assert drive(make_simulator(physics, ROBOT, 0.1), post, [Pose2D(3.0, 2.0, 0.0)], ahead) == [(0, "cylinder", 1)]


def test_movers_and_other_robots_are_told_from_walls():
    mover = Mover(0.2, np.array([[4.0, 2.0], [1.0, 2.0]]), 0.5)
    world = hall(circles=[(1.0, 1.0, 0.1)], movers=[mover])
    still = [Twist(0.0, 0.0)]
    assert drive(KinematicSimulator(ROBOT, 0.1), world, [Pose2D(2.0, 2.0, 0.0)], still) == [(0, "mover", 0)]
    poses, twists = [Pose2D(2.0, 2.0, 0.0), Pose2D(3.0, 2.0, 0.0)], [Twist(0.2, 0.0), Twist(0.0, 0.0)]
    both = drive(KinematicSimulator(ROBOT, 0.1, 2), hall(), poses, twists)
    assert both == [(0, "robot", 1), (1, "robot", 0)]

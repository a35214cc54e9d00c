"""Kinematic robots that run into each other."""

import math

import numpy as np
import pytest

from envs.geometry import Pose2D
from envs.robots import load_robot
from envs.simulation import Twist
from envs.simulation.kinematic import X
from envs.simulation.team import KinematicTeam
from envs.worlds import World

BURGER = load_robot("turtlebot3_burger")
STILL = Twist(0.0, 0.0)


def hall(width):
    walls = [[0, 0, width, 0], [width, 0, width, 4], [width, 4, 0, 4], [0, 4, 0, 0]]
    return World(
        name="hall",
        segments=np.array(walls, dtype=float),
        circles=np.empty((0, 3)),
        spawns=(Pose2D(1.0, 1.0, 0.0),),
        bounds=(0.0, 0.0, width, 4.0),
    )


def place(world, *poses):
    team = KinematicTeam(BURGER, 0.1, len(poses))
    team.reset(world, poses, np.random.default_rng(0).spawn(len(poses)))
    return team


def test_who_runs_into_a_wall_does_not_bump_into_the_mate_beside_it():
    ahead = 1.0 + 2.0 * BURGER.radius + 2e-4
    world = hall(ahead + BURGER.radius + 2e-5)
    team = place(world, Pose2D(1.0, 2.0, 0.0), Pose2D(ahead, 2.0, 0.0))
    # They stand 0.05 mm apart: nearer than robots may start.
    team._members[0].row[X] += 1.5e-4
    for _ in range(3):
        readings = team.step([STILL, Twist(BURGER.max_v, 0.0)])
        assert [reading.bumper for reading in readings] == [False, True]


@pytest.mark.parametrize("lead", [0.0, 0.005, 0.01, 0.015])
@pytest.mark.parametrize("first", [0, 1])
def test_who_is_grazed_feels_it_in_the_same_step(lead, first):
    # It passes with an overlap of 1 mm, and is clear of the other one before the period ends.
    poses = [
        Pose2D(1.0 - lead, 2.0, 0.0),
        Pose2D(1.3, 2.0 + 2.0 * BURGER.radius - 1e-3, math.pi),
        Pose2D(4.0, 2.0, 0.0),
    ]
    commands = [Twist(BURGER.max_v, 0.0), STILL, STILL]
    if first:
        poses[:2], commands[:2] = poses[1::-1], commands[1::-1]
    team = place(hall(6.0), *poses)
    felt = np.array([[reading.bumper for reading in team.step(commands)] for _ in range(30)])
    assert felt[:, 0].any()
    assert not felt[-1].any()
    np.testing.assert_array_equal(felt[:, 0], felt[:, 1])
    assert not felt[:, 2].any()

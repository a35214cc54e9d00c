import math
from dataclasses import replace

import numpy as np
import pytest

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.simulation import Twist, make_simulator
from lidarnaut.envs.worlds import FixedRoute
from tests.rooms import BURGER, begin, make_room

STILL = Twist(0.0, 0.0)
HALL = make_room(0.0, 0.0, 22.0, 4.0)
LEFT, RIGHT = Pose2D(1.0, 2.0, 0.0), Pose2D(3.0, 2.0, 0.0)
PERSON = FixedRoute(0.2, np.array([[4.0, 2.0], [1.0, 2.0]]), 0.5)


@pytest.mark.parametrize(
    ("bodies", "xs", "speed", "contacts"),
    [
        ({}, [5.0], 0.2, [(0, "wall", 1, "robot")]),
        ({"circles": [(1.0, 1.0, 0.1), (4.0, 2.0, 0.2)]}, [3.0], 0.2, [(0, "cylinder", 1, "robot")]),
        ({"circles": [(1.0, 1.0, 0.1)], "people": [PERSON]}, [2.0], 0.0, [(0, "person", 0, "other")]),
        ({}, [2.0, 3.0], 0.2, [(0, "robot", 1, "robot"), (1, "robot", 0, "other")]),
    ],
)
def test_a_contact_says_what_was_touched(physics, bodies, xs, speed, contacts):
    world = make_room(0.0, 0.0, 6.0, 4.0, **bodies)
    simulator = begin(physics, BURGER, world, *(Pose2D(x, 2.0, 0.0) for x in xs))
    assert list(simulator.contacts) == []
    for _ in range(200):
        simulator.step([Twist(speed, 0.0), STILL][: len(xs)])
        if simulator.contacts:
            break
    assert simulator.contacts == contacts


def test_a_robot_that_runs_into_a_wall_does_not_bump_into_the_peer_beside_it():
    ahead = 1.0 + 2.0 * BURGER.radius + 2e-4
    world = make_room(0.0, 0.0, ahead + BURGER.radius + 2e-5, 4.0)
    simulator = begin("kinematic", BURGER, world, LEFT, Pose2D(ahead, 2.0, 0.0))
    simulator.rows.numbers["x"][0] += 1.5e-4  # a gap of 0.05 mm is below the minimum at the start
    for _ in range(3):
        readings = simulator.step([STILL, Twist(BURGER.max_v, 0.0)])
        assert [reading.bumper for reading in readings] == [False, True]


@pytest.mark.parametrize("lead", [0.0, 0.005, 0.01, 0.015])
@pytest.mark.parametrize("order", [[0, 1, 2], [1, 0, 2]])
def test_both_robots_of_a_grazing_collision_are_in_contact_in_the_same_step(lead, order):
    # It passes with an overlap of 1 mm, and is clear of the other one before the period ends.
    beside = Pose2D(1.3, 2.0 + 2.0 * BURGER.radius - 1e-3, math.pi)
    poses = [Pose2D(1.0 - lead, 2.0, 0.0), beside, Pose2D(4.0, 2.0, 0.0)]
    commands = [Twist(BURGER.max_v, 0.0), STILL, STILL]
    simulator = begin("kinematic", BURGER, HALL, *(poses[k] for k in order))
    commands = [commands[k] for k in order]
    touched = np.array([[reading.bumper for reading in simulator.step(commands)] for _ in range(30)])
    assert touched[:, 0].any()
    assert not touched[-1].any()
    np.testing.assert_array_equal(touched[:, 0], touched[:, 1])
    assert not touched[:, 2].any()


def test_peers_do_not_change_what_a_distant_robot_senses(physics):
    """Each robot has its own noise generator: readings are equal with and without other robots."""
    poses = [LEFT, Pose2D(20.0, 2.0, 0.0)]
    commands = [Twist(0.2, 0.5), Twist(-0.1, 1.0)]
    together = make_simulator(physics, BURGER, 0.1, 2)
    readings = [together.reset(HALL, poses, np.random.default_rng(3).spawn(2))]
    readings += [together.step(commands) for _ in range(10)]
    for k in range(2):
        alone = make_simulator(physics, BURGER, 0.1)
        reading = alone.reset(HALL, [poses[k]], [np.random.default_rng(3).spawn(2)[k]])[0]
        for among in readings:
            np.testing.assert_allclose(among[k].ranges, reading.ranges, atol=1e-6)
            assert among[k].ticks == reading.ticks
            reading = alone.step([commands[k]])[0]


def test_robots_see_each_other_as_circles(physics):
    robot = replace(BURGER, lidar=replace(BURGER.lidar, noise_std=0.0, resolution=0.0))
    simulator = make_simulator(physics, robot, 0.1, 2)
    first, second = simulator.reset(HALL, [LEFT, RIGHT], np.random.default_rng(0).spawn(2))
    ahead, behind = robot.lidar.num_beams // 2, 0
    assert first.ranges[ahead] == pytest.approx(2.0 - robot.radius - robot.lidar.mount.x, abs=1e-5)
    assert second.ranges[behind] == pytest.approx(2.0 - robot.radius + robot.lidar.mount.x, abs=1e-5)


def test_each_robot_needs_a_pose_a_generator_and_a_command(physics):
    simulator, rngs = make_simulator(physics, BURGER, 0.1, 2), np.random.default_rng(0).spawn(2)
    for poses, generators, complaint in (
        ([LEFT], rngs, "poses must have one entry per robot, 2 in all, got 1"),
        ([LEFT, RIGHT], rngs[:1], "rngs must have one entry per robot, 2 in all, got 1"),
        ([LEFT, Pose2D(1.2, 2.0, 0.0)], rngs, r"robots 0 and 1 start 0\.200 m apart"),
    ):
        with pytest.raises(ValueError, match=complaint):
            simulator.reset(HALL, poses, generators)
    simulator.reset(HALL, [LEFT, RIGHT], rngs)
    with pytest.raises(ValueError, match="commands must have one entry per robot, 2 in all, got 1"):
        simulator.step([STILL])
    with pytest.raises(ValueError, match="num_robots must be at least 1, got 0"):
        make_simulator(physics, BURGER, 0.1, 0)

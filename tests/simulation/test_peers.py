"""Several robots that see each other and run into each other."""

import math
from dataclasses import replace

import numpy as np
import pytest

from envs.geometry import Pose2D
from envs.robots import load_robot
from envs.simulation import KinematicSimulator, Twist, make_simulator
from envs.simulation.records import X
from tests.rollouts import hall

BURGER = load_robot("turtlebot3_burger")
STILL = Twist(0.0, 0.0)


def reset_at(world, *poses):
    simulator = KinematicSimulator(BURGER, 0.1, len(poses))
    simulator.reset(world, poses, np.random.default_rng(0).spawn(len(poses)))
    return simulator


def test_a_robot_that_runs_into_a_wall_does_not_bump_into_the_peer_beside_it():
    ahead = 1.0 + 2.0 * BURGER.radius + 2e-4
    world = hall(ahead + BURGER.radius + 2e-5)
    simulator = reset_at(world, Pose2D(1.0, 2.0, 0.0), Pose2D(ahead, 2.0, 0.0))
    # A gap of 0.05 mm is less than robots may start with.
    simulator.rows.numbers[0, X] += 1.5e-4
    for _ in range(3):
        readings = simulator.step([STILL, Twist(BURGER.max_v, 0.0)])
        assert [reading.bumper for reading in readings] == [False, True]


@pytest.mark.parametrize("lead", [0.0, 0.005, 0.01, 0.015])
@pytest.mark.parametrize("first", [0, 1])
def test_both_robots_of_a_grazing_collision_are_in_contact_in_the_same_step(lead, first):
    # It passes with an overlap of 1 mm, and is clear of the other one before the period ends.
    poses = [
        Pose2D(1.0 - lead, 2.0, 0.0),
        Pose2D(1.3, 2.0 + 2.0 * BURGER.radius - 1e-3, math.pi),
        Pose2D(4.0, 2.0, 0.0),
    ]
    commands = [Twist(BURGER.max_v, 0.0), STILL, STILL]
    if first:
        poses[:2], commands[:2] = poses[1::-1], commands[1::-1]
    simulator = reset_at(hall(6.0), *poses)
    touched = np.array([[reading.bumper for reading in simulator.step(commands)] for _ in range(30)])
    assert touched[:, 0].any()
    assert not touched[-1].any()
    np.testing.assert_array_equal(touched[:, 0], touched[:, 1])
    assert not touched[:, 2].any()


def test_peers_do_not_change_what_a_distant_robot_senses(physics):
    """Each robot has noise of its own; alone or among others, it reads the same."""
    poses = [Pose2D(1.0, 2.0, 0.0), Pose2D(20.0, 2.0, 0.0)]
    commands = [Twist(0.2, 0.5), Twist(-0.1, 1.0)]
    together = make_simulator(physics, BURGER, 0.1, 2)
    readings = [together.reset(hall(22.0), poses, np.random.default_rng(3).spawn(2))]
    readings += [together.step(commands) for _ in range(10)]
    for k in range(2):
        alone = make_simulator(physics, BURGER, 0.1)
        reading = alone.reset(hall(22.0), [poses[k]], [np.random.default_rng(3).spawn(2)[k]])[0]
        for among in readings:
            np.testing.assert_allclose(among[k].ranges, reading.ranges, atol=1e-6)
            assert among[k].ticks == reading.ticks
            reading = alone.step([commands[k]])[0]
        alone.close()
    together.close()


def test_robots_see_each_other_as_circles(physics):
    robot = replace(BURGER, lidar=replace(BURGER.lidar, noise_std=0.0, resolution=0.0))
    simulator = make_simulator(physics, robot, 0.1, 2)
    poses = [Pose2D(1.0, 2.0, 0.0), Pose2D(3.0, 2.0, 0.0)]
    first, second = simulator.reset(hall(8.0), poses, np.random.default_rng(0).spawn(2))
    ahead, behind = robot.lidar.num_beams // 2, 0
    assert first.ranges[ahead] == pytest.approx(2.0 - robot.radius - robot.lidar.mount.x, abs=1e-5)
    assert second.ranges[behind] == pytest.approx(2.0 - robot.radius + robot.lidar.mount.x, abs=1e-5)
    simulator.close()


def test_each_robot_needs_a_pose_a_generator_and_a_command(physics):
    simulator = make_simulator(physics, BURGER, 0.1, 2)
    poses, rngs = [Pose2D(1.0, 2.0, 0.0), Pose2D(3.0, 2.0, 0.0)], np.random.default_rng(0).spawn(2)
    with pytest.raises(ValueError, match="poses must have one entry per robot, 2 in all, got 1"):
        simulator.reset(hall(8.0), poses[:1], rngs)
    with pytest.raises(ValueError, match="rngs must have one entry per robot, 2 in all, got 1"):
        simulator.reset(hall(8.0), poses, rngs[:1])
    with pytest.raises(ValueError, match=r"robots 0 and 1 start 0\.200 m apart"):
        simulator.reset(hall(8.0), [poses[0], Pose2D(1.2, 2.0, 0.0)], rngs)
    simulator.reset(hall(8.0), poses, rngs)
    with pytest.raises(ValueError, match="commands must have one entry per robot, 2 in all, got 1"):
        simulator.step([STILL])
    simulator.close()


def test_there_is_at_least_one_robot(physics):
    with pytest.raises(ValueError, match="num_robots must be at least 1, got 0"):
        make_simulator(physics, BURGER, 0.1, 0)

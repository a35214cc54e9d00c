"""Same seed, same bytes, whatever happened before."""

import numpy as np
import pytest

from envs.geometry import Pose2D
from envs.robots import load_robot
from envs.simulation import Twist, make_simulator

NEAR_WALL = Pose2D(1.2, 0.0, 0.1)


@pytest.fixture
def world(room):
    posts = [[2.0, 3.5, 0.3], [0.0, -3.0, 0.1]]
    return room(5.0, segments=[[2, -1, 2, 1], [2, 2, 3, 3], [2, -2, 2.3, -2.05]], circles=posts)


def record(simulator, world, pose, seed, steps=60):
    """All readings and states of an episode of random commands."""
    rng = np.random.default_rng(1000 + seed)
    reading = simulator.reset(world, [pose], [np.random.default_rng(seed)])[0]
    log = []
    for step in range(steps):
        said = (reading.time, reading.ticks, reading.yaw_rate, reading.heading, reading.bumper)
        log.append(reading.ranges.tobytes() + repr((said, simulator.states[0])).encode())
        if step % 10 == 0:
            command = Twist(*rng.uniform(-1, 1, 2))
        reading = simulator.step([command])[0]
    return log


@pytest.mark.parametrize("name", ["turtlebot3_burger", "mpo_500", "tugbot"])
def test_an_episode_repeats_after_other_episodes(physics, name, world, room):
    robot = load_robot(name)
    simulator = make_simulator(physics, robot, 0.1)
    expected = record(make_simulator(physics, robot, 0.1), world, NEAR_WALL, seed=0)
    assert record(simulator, world, NEAR_WALL, seed=0) == expected
    rng = np.random.default_rng(5)
    for episode in range(12):
        pose = NEAR_WALL if episode % 2 else Pose2D(1.15, 0.03, rng.uniform(-3, 3))
        simulator.reset(world, [pose], [rng])
        for _ in range(rng.integers(0, 12)):
            simulator.step([Twist(*rng.uniform(-1, 1, 2))])
        assert record(simulator, world, NEAR_WALL, seed=0) == expected
    record(simulator, room(4.0, segments=[[1, 1, 2, 1.5]]), Pose2D(0.0, 0.0, 1.0), seed=3)
    assert record(simulator, world, NEAR_WALL, seed=0) == expected
    simulator.close()
    assert record(simulator, world, NEAR_WALL, seed=0) == expected


def test_another_seed_is_another_episode(physics, world):
    simulator = make_simulator(physics, load_robot("turtlebot3_burger"), 0.1)
    first = record(simulator, world, NEAR_WALL, seed=0, steps=3)
    assert record(simulator, world, NEAR_WALL, seed=1, steps=3) != first


def test_both_physics_draw_the_same_noise(bullet, world):
    """Standing still, the robot senses the same under both, draw for draw."""
    robot = load_robot("mpo_500")
    readings = []
    for physics in (bullet, "kinematic"):
        simulator = make_simulator(physics, robot, 0.1)
        simulator.reset(world, [NEAR_WALL], [np.random.default_rng(4)])
        readings.append([simulator.step([Twist(0.0, 0.0)])[0] for _ in range(3)][-1])
    np.testing.assert_allclose(readings[0].ranges, readings[1].ranges, atol=2e-3)
    assert readings[0].yaw_rate == pytest.approx(readings[1].yaw_rate, abs=1e-4)
    assert readings[0].heading == pytest.approx(readings[1].heading)

import numpy as np
import pytest

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.simulation import Twist, make_simulator
from tests.rooms import BURGER, ORIGIN, begin, square_room

NEAR_WALL = Pose2D(1.2, 0.0, 0.1)
WALLS = [[2, -1, 2, 1], [2, 2, 3, 3], [2, -2, 2.3, -2.05]]
WORLD = square_room(5.0, WALLS, circles=[[2.0, 3.5, 0.3], [0.0, -3.0, 0.1]])


def record(simulator, seed, steps=60, world=WORLD, pose=NEAR_WALL):
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
def test_an_episode_repeats_after_other_episodes(physics, name):
    robot = load_robot(name)
    simulator = make_simulator(physics, robot, 0.1)
    expected = record(make_simulator(physics, robot, 0.1), seed=0)
    assert record(simulator, seed=0) == expected
    rng = np.random.default_rng(5)
    for episode in range(12):
        pose = NEAR_WALL if episode % 2 else Pose2D(1.15, 0.03, rng.uniform(-3, 3))
        simulator.reset(WORLD, [pose], [rng])
        for _ in range(rng.integers(0, 12)):
            simulator.step([Twist(*rng.uniform(-1, 1, 2))])
        assert record(simulator, seed=0) == expected
    record(simulator, seed=3, world=square_room(4.0, [[1, 1, 2, 1.5]]), pose=ORIGIN)
    assert record(simulator, seed=0) == expected
    simulator.close()
    assert record(simulator, seed=0) == expected
    assert record(simulator, seed=1, steps=3) != expected[:3]


def test_both_physics_draw_the_same_noise(bullet):
    readings = []
    for physics in (bullet, "kinematic"):
        simulator = begin(physics, load_robot("mpo_500"), WORLD, NEAR_WALL)
        readings.append([simulator.step([Twist(0.0, 0.0)])[0] for _ in range(3)][-1])
    np.testing.assert_allclose(readings[0].ranges, readings[1].ranges, atol=2e-3)
    assert readings[0].yaw_rate == pytest.approx(readings[1].yaw_rate, abs=1e-4)
    assert readings[0].heading == pytest.approx(readings[1].heading)


def test_two_simulators_do_not_disturb_each_other(bullet):
    first, second = (begin(bullet, BURGER, square_room(3.0), ORIGIN) for _ in range(2))
    for _ in range(20):
        first.step([Twist(0.2, 1.0)])
        second.step([Twist(-0.2, 0.0)])
    assert first.states[0].pose.theta > 1.0
    assert second.states[0].pose.x < -0.3
    second.close()
    first.step([Twist(0.2, 1.0)])

import gymnasium
import numpy as np
import pytest

from lidarnaut.envs.navigation.controllers.collision_monitor import CollisionMonitor
from lidarnaut.envs.navigation.maps.obstacles import stoppable_share
from lidarnaut.envs.robots import load_robot

CLUTTER = {"id": "lidarnaut/ReachClutter-v0", "difficulty": 0.3, "contact": "costs", "time_limit": 1e3}


def drive_blindly(seed, **arguments):
    """Return wall contacts and path length of a robot with a 360 degree view and random curves."""
    env = gymnasium.make(**CLUTTER, robot="configs/robots/jackal_360.yaml", **arguments)
    _, info = env.reset(seed=seed)
    rng = np.random.default_rng(seed)
    for step in range(400):
        if step % 20 == 0:
            action = np.array([1.0, rng.uniform(-1.0, 1.0)], dtype=np.float32)
        info = env.step(action)[-1]
    return info["collisions"], info["path_length"]


@pytest.mark.parametrize(("physics", "episodes"), [("kinematic", 3), ("bullet", 1)])
def test_a_robot_that_sees_all_around_touches_a_twentieth_of_what_it_would(physics, episodes):
    slowed, free = (
        np.array([drive_blindly(seed, physics=physics, collision_monitor=has_one) for seed in range(episodes)])
        for has_one in (True, False)
    )
    assert slowed[:, 0].sum() <= 0.05 * free[:, 0].sum()
    assert slowed[:, 1].min() > 10.0


@pytest.mark.parametrize(("wall", "share"), [(10.0, 1.0), (0.333, 0.0), (0.9, None)])
def test_the_robot_can_stop_short_of_what_is_ahead(wall, share):
    points = np.array([[wall, 0.0]])
    v, braking, period = 2.0, 2.5, 0.1
    found = stoppable_share(points, v, 0.0, 0.333, braking, period)
    assert share is None or found == pytest.approx(share, abs=1e-6)
    if found < 1.0:
        assert found * v * period + 0.5 * (found * v) ** 2 / braking == pytest.approx(wall - 0.333, abs=0.02)
    assert stoppable_share(points, 0.0, 1.0, 0.333, braking, period) == 1.0
    assert stoppable_share(points, -v, 0.0, 0.333, braking, period) == 1.0


def test_who_is_stopped_can_still_turn():
    robot = load_robot("jackal")
    ranges = np.full((2, robot.lidar.num_beams), robot.radius, dtype=np.float32)
    commands = np.array([[2.0, 1.5], [2.0, 1.5]])
    CollisionMonitor(robot, 0.1).slow_down(commands, ranges, np.array([True, False]))
    np.testing.assert_allclose(commands, [[0.0, 1.5], [2.0, 1.5]], atol=1e-9)

"""The collision monitor: robots that drive anywhere at full speed, and touch nothing that they see."""

import gymnasium
import numpy as np
import pytest

import envs  # noqa: F401
from envs.navigation.obstacles import stoppable_share

CLUTTER = {
    "id": "lidarnaut/ReachClutter-v0",
    "world": "clutter",
    "difficulty": 0.3,
    "contact": "costs",
    "time_limit": 1e3,
}


def drive_blindly(seed, **arguments):
    """Return contacts with walls and the path length of a robot that sees all around and draws a curve now and then."""
    env = gymnasium.make(**CLUTTER, robot="configs/robots/jackal_360.yaml", **arguments)
    _, info = env.reset(seed=seed)
    rng = np.random.default_rng(seed)
    for step in range(400):
        if step % 20 == 0:
            action = np.array([1.0, rng.uniform(-1.0, 1.0)], dtype=np.float32)
        info = env.step(action)[-1]
    return info["collisions"], info["path_length"]


@pytest.mark.parametrize("physics", ["kinematic", "bullet"])
def test_a_robot_that_sees_all_around_touches_nothing_however_it_is_driven(physics):
    runs = np.array([drive_blindly(seed, physics=physics, collision_monitor=True) for seed in range(4)])
    assert runs[:, 0].sum() == 0
    assert runs[:, 1].min() > 1.0
    assert drive_blindly(0, physics=physics)[0] > 0


@pytest.mark.parametrize(("wall", "share"), [(10.0, 1.0), (0.333, 0.0), (0.9, None)])
def test_commands_keep_their_arc_and_the_robot_can_stop_short_of_what_is_ahead(wall, share):
    points = np.array([[wall, 0.0]])
    v, braking, period = 2.0, 2.5, 0.1
    found = stoppable_share(points, v, 0.5, 0.333, braking, period)
    assert share is None or found == pytest.approx(share, abs=1e-6)
    assert found * v * period + 0.5 * (found * v) ** 2 / braking <= max(wall - 0.333, 0.0) + 0.03
    assert stoppable_share(points, 0.0, 1.0, 0.333, braking, period) == 1.0
    assert stoppable_share(points, -v, 0.5, 0.333, braking, period) == 1.0


def test_environments_that_are_stepped_together_slow_down_as_alone():
    arguments = {**CLUTTER, "robot": "jackal", "physics": "kinematic", "collision_monitor": True}
    alone, together = gymnasium.make(**arguments), gymnasium.make_vec(num_envs=2, **arguments)
    alone.reset(seed=3)
    together.reset(seed=3)
    for _ in range(100):
        observation, reward, *_ = alone.step(np.array([1.0, 0.1], dtype=np.float32))
        seen, rewards, *_ = together.step(np.full((2, 2), (1.0, 0.1), dtype=np.float32))
        assert reward == rewards[0]
        assert all(np.array_equal(part, seen[name][0]) for name, part in observation.items())
        assert list(observation) == list(seen)

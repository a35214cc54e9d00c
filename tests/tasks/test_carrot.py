import math

import gymnasium
import numpy as np
import pytest

import lidarnaut  # noqa: F401  registers the environments
from lidarnaut.envs.tasks import carrot

OBSERVATIONS = {"carrot": {"path": "shortest"}, "goal": None}
WALL = {"world": "hall", "world_size": (8.0, 8.0), "robot": "jackal", "physics": "kinematic"}
FLAT = {"world": "rooms", "robot": "turtlebot3_burger", "min_distance": 5.0}


@pytest.fixture
def is_near(monkeypatch):
    """Bring the point so near that whoever follows it does not cut corners."""
    monkeypatch.setattr(carrot, "AHEAD", 0.3)


def follow(path, seed, id="lidarnaut/ReachGoal-v0", **arguments):
    observations = {"carrot": {"path": path} if path else {}}
    env = gymnasium.make(id, **{**WALL, "observations": observations, "min_distance": 4.0, **arguments})
    observation, _ = env.reset(seed=seed)
    angles, has_ended = [], False
    while not has_ended:
        c, s, _ = observation["carrot"].astype(np.float64)
        angles.append(math.atan2(s, c))
        action = np.array([0.5 * max(c, 0.0) ** 4, np.clip(2.0 * angles[-1], -1.0, 1.0)], dtype=np.float32)
        observation, _, terminated, truncated, info = env.step(action)
        has_ended = terminated or truncated
    return info, np.array(angles)


@pytest.mark.parametrize("path", ["plan", "shortest"])
@pytest.mark.usefixtures("is_near")
def test_who_follows_the_carrot_gets_around_walls_to_the_goal(path):
    for seed in range(2):
        info, _ = follow(path, seed, "lidarnaut/ReachClutter-v0", world="clutter", world_size=None, contact="costs")
        assert info["is_success"], (path, seed)


@pytest.mark.usefixtures("is_near")
def test_on_a_known_map_the_carrot_leads_through_unseen_doors():
    episodes = [follow(None, seed, "lidarnaut/Navigate-v0", **FLAT) for seed in range(3)]
    assert all(info["is_success"] for info, _ in episodes)
    assert max(np.abs(angles).max() for _, angles in episodes) > 0.5


def test_near_the_goal_the_carrot_is_the_goal():
    env = gymnasium.make("lidarnaut/ReachGoal-v0", observations=OBSERVATIONS, **WALL)
    env.reset(seed=0)
    observation, _ = env.reset(seed=0, options={"goal": (0.48, 0.0, 0.0)})
    np.testing.assert_allclose(observation["carrot"], (1.0, 0.0, 0.6), atol=0.1)
    np.testing.assert_allclose(observation["goal"][1:3], observation["carrot"][:2], atol=1e-6)


def test_the_carrot_leads_around_goals_with_a_heading_within_their_tolerance():
    tolerances = {"goal_tolerance": 0.02, "heading_tolerance": 0.05}
    env = gymnasium.make("lidarnaut/Navigate-v0", observations=("carrot",), localizer="truth", **tolerances, **WALL)
    env.reset(seed=0)
    observation, _ = env.reset(seed=0, options={"goal": tuple(env.unwrapped.belief.pose)})
    assert observation["carrot"][2] == pytest.approx(0.02 / carrot.AHEAD, rel=1e-3)


def test_other_paths_are_refused():
    with pytest.raises(ValueError, match="path of carrot"):
        gymnasium.make("lidarnaut/ReachGoal-v0", observations={"carrot": {"path": "straight"}}, **WALL)

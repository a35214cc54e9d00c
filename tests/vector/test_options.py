"""Costs apart from rewards, and options that last longer than an episode, in single and vector environments."""

import gymnasium
import numpy as np
import pytest

from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.tasks.explore import ExploreTeam
from lidarnaut.envs.tasks.reach_goal import ReachGoal
from lidarnaut.envs.worlds import load_world

ROOM = {"world": "hall", "physics": "kinematic", "control_hz": 5.0}
CROWDED = ROOM | {"world_size": (6.0, 6.0), "people": {"number": 12, "attentive": 0.0}, "cost": True, "time_limit": 9.0}


def costs_of(env, actions):
    """Return the costs of the steps of an episode, and costs from contacts and gaps in the state."""
    found, expected = [], []
    _, info = env.reset(seed=1)
    assert info["cost"] == 0.0
    for action in actions:
        *_, terminated, truncated, info = env.step(action)
        assert type(info["cost"]) is float
        numbers = env.unwrapped.rows.numbers
        expected.append(sum(float(row["touched"] > 0.0) + float(row["person_gap"] < 0.45) for row in numbers))
        found.append(info["cost"])
        if terminated or truncated:
            break
    return found, expected


@pytest.mark.parametrize(
    ("task", "arguments", "values"),
    [
        (ReachGoal, {"contact": "costs"}, {0.0, 1.0, 2.0}),
        (ReachGoal, {}, {0.0, 1.0, 2.0}),
        (ExploreTeam, {}, {0.0, 1.0}),
    ],
)
def test_a_cost_counts_contacts_and_intrusions_apart_from_rewards(task, arguments, values):
    env, plain = (LidarEnv(task, **arguments, **CROWDED | {"cost": cost}) for cost in (True, False))
    actions = [np.ones(env.action_space.shape, dtype=np.float32)] * 45
    found, expected = costs_of(env, actions)
    assert found == expected
    assert {*found} >= values if task is ReachGoal and arguments else len({*found}) > 1
    _, info = plain.reset(seed=1)
    assert "cost" not in info


class Growing:
    """World sampler with a state: another world from the third episode on."""

    def __init__(self):
        self.count = 0

    def __call__(self, rng):
        self.count += 1
        return load_world("turtlebot3_world" if self.count < 3 else "pimouse_arena")


def worlds_of(vector, steps):
    """Return the names of the worlds of each sub-environment, step by step."""
    names = []
    for _ in range(steps):
        vector.step(np.zeros(vector.action_space.shape, dtype=np.float32))
        names.append([world.name for world in vector.get_attr("world")])
    return names


VECTORS = {
    "worker processes": {"num_workers": 2},
    "one process": {"num_workers": 1},
    "sync": {"vectorization_mode": "sync"},
    "async": {"vectorization_mode": "async"},
}


@pytest.mark.parametrize("kind", VECTORS)
def test_options_of_a_curriculum_last_until_the_next_ones(kind):
    """Each episode has two steps; resets of one episode take precedence."""
    arguments = ROOM | {"world": "turtlebot3_world", "time_limit": 0.4}
    vector = gymnasium.make_vec("lidarnaut/ReachGoal-v0", 2, **VECTORS[kind], **arguments)
    vector.reset(seed=0)
    vector.call("set_options", {"world": "pimouse_arena", "min_distance": 0.8})
    names = worlds_of(vector, 9)
    assert names[:2] == [["turtlebot3_world"] * 2] * 2
    assert names[2:] == [["pimouse_arena"] * 2] * 7
    vector.reset(options={"world": "turtlebot3_world"})
    assert worlds_of(vector, 3) == [["turtlebot3_world"] * 2] * 2 + [["pimouse_arena"] * 2]
    vector.call("set_options", None)
    assert worlds_of(vector, 6)[-1] == ["turtlebot3_world"] * 2
    with pytest.raises(
        ValueError, match=r"unknown options \['level'\]; allowed are \['world', 'start', 'goal', 'min_d"
    ):
        vector.call("set_options", {"level": 3})
    vector.close()


@pytest.mark.parametrize("kind", VECTORS)
def test_a_world_sampler_keeps_its_state_over_episodes(kind):
    arguments = ROOM | {"world": Growing(), "time_limit": 0.4}
    vector = gymnasium.make_vec("lidarnaut/ReachGoal-v0", 1, **VECTORS[kind], **arguments)
    vector.reset(seed=0)
    names = [name for (name,) in worlds_of(vector, 9)]
    assert (names[0], names[-1]) == ("turtlebot3_world", "pimouse_arena")
    assert names == sorted(names, reverse=True)
    vector.close()


@pytest.mark.parametrize("id", ["ReachGoal", "Navigate", "ExploreFrontiers"])
def test_options_hold_for_all_resets_of_a_single_environment(id):
    more = {"Navigate": {"localizer": "truth"}, "ExploreFrontiers": {"slam": "odometry"}}.get(id, {})
    env = gymnasium.make(f"lidarnaut/{id}-v0", **ROOM, **more)
    inner = getattr(env.unwrapped, "explore", env.unwrapped)
    env.unwrapped.set_options({"world": "turtlebot3_world"} | ({"min_distance": 2.0} if "Frontiers" not in id else {}))
    for seed in (0, None, 1):
        env.reset(seed=seed)
        assert inner.world.name == "turtlebot3_world"
        if inner.task.goal is not None:
            assert np.hypot(*np.subtract(inner.task.tell_goal(inner.belief.pose)[:2], inner.belief.pose[:2])) > 1.9
    env.reset(options={"world": "pimouse_arena"})
    assert inner.world.name == "pimouse_arena"
    if "Frontiers" not in id:
        with pytest.raises(ValueError, match="min_distance must be positive, got -1"):
            env.reset(options={"min_distance": -1})

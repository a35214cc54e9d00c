"""Goals in the form of Gymnasium-Robotics, and hindsight experience replay of stable-baselines3 on them."""

import math

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from lidarnaut.envs.core import lidar_env_of
from lidarnaut.envs.vector import make_vec
from lidarnaut.envs.wrappers import GoalEnv

REACH = {"world": "rooms", "world_size": (6.0, 6.0), "physics": "kinematic", "control_hz": 5.0}
REACH |= {"contact": "costs", "time_limit": 6.0}
CASES = {
    "odometry": ("ReachGoal", REACH),
    "true pose, maps": ("ReachGoal", REACH | {"slam": "truth", "observations": ("scan", "map_near", "goal")}),
    "known map": ("Navigate", {key: REACH[key] for key in REACH if key != "contact"} | {"localizer": "truth"}),
}


def make(name="odometry", **changes):
    id, arguments = CASES[name]
    return GoalEnv(gymnasium.make(f"lidarnaut/{id}-v0", **arguments | changes))


@pytest.mark.parametrize("case", CASES)
def test_rewards_of_steps_equal_those_computed_from_goals(case):
    """The contract of `GoalEnv`, also for virtual goals and for batches, with and without `info`."""
    env = make(case, time_limit=20.0)
    check_env(env, skip_render_check=True)
    inner, seen, rewards = lidar_env_of(env), [], []
    for seed in range(4):
        observation, info = env.reset(seed=seed, options={"min_distance": 0.4})
        assert set(observation) == {"observation", "achieved_goal", "desired_goal"}
        end = False
        while not end:
            assert env.observation_space.contains(observation)
            x, y = observation["desired_goal"] - observation["achieved_goal"]
            cosine, sine = observation["observation"][-2:]
            turn = math.atan2(cosine * y - sine * x, cosine * x + sine * y)
            action = np.clip([math.cos(turn), turn], -1.0, 1.0).astype(np.float32)
            observation, reward, terminated, truncated, info = env.step(action)
            goals = observation["achieved_goal"], observation["desired_goal"]
            assert reward == env.compute_reward(*goals, info)
            assert (reward == 0.0) == (math.dist(*goals) <= inner.task.goal_tolerance)
            pose, goal = inner.belief.pose, inner.task.goal
            np.testing.assert_allclose(goals, (pose[:2], goal[:2]), atol=1e-6)
            np.testing.assert_allclose(
                observation["observation"][-2:], [math.cos(pose.theta), math.sin(pose.theta)], atol=1e-6
            )
            seen.append(goals)
            rewards.append(reward)
            end = terminated or truncated
    assert env.compute_reward(goals[0], goals[0], {}) == 0.0
    achieved, desired = (np.array(column) for column in zip(*seen))
    batch = env.compute_reward(achieved, desired, np.array([{}] * len(seen)))
    assert (batch.shape, batch.dtype) == ((len(seen),), np.float32)
    np.testing.assert_array_equal(batch, rewards)
    assert {*rewards} == {0.0, -1.0}


def test_observations_do_not_show_the_goal():
    env, seen = make(goal="random"), []
    for goal in ((1.0, 0.0), (0.0, 1.0)):
        inner = lidar_env_of(env)
        observation, _ = env.reset(seed=0, options={"start": "spawn", "world": "hall", "goal": goal})
        assert tuple(observation["desired_goal"]) == goal
        assert inner.task.goal[:2] == goal
        seen.append(observation["observation"])
    np.testing.assert_array_equal(*seen)


@pytest.mark.parametrize(
    ("id", "changes", "message"),
    [
        ("ReachGoal", {"contact": "ends"}, "needs contact='costs'"),
        ("ReachGoal", {"contact": "costs", "goal_given": "bearing"}, "whose goal is a known position, got ReachGoal"),
        ("ReachGoal", {"contact": "costs", "observations": ["motion", "trajectories", "carrot"]}, r"\['carrot', 'traj"),
        ("Explore", {}, "whose goal is a known position, got Explore"),
        ("ReachGoal", {"contact": "costs", "heading_tolerance": 0.1, "goal": (1.0, 0.0, 0.0)}, "without a heading"),
    ],
)
def test_what_hindsight_cannot_replace_is_refused(id, changes, message):
    with pytest.raises(ValueError, match=message):
        GoalEnv(gymnasium.make(f"lidarnaut/{id}-v0", physics="kinematic", world="hall", **changes)).reset(seed=0)


def vector_of_sb3(kind):
    if kind == "DummyVecEnv":
        from stable_baselines3.common.env_util import make_vec_env

        return make_vec_env(make, n_envs=2, seed=0)
    from lidarnaut.agents.vec_env import GymnasiumVecEnv

    mode = gymnasium.vector.AutoresetMode.SAME_STEP
    vector = make_vec("lidarnaut/ReachGoal-v0", 2, wrappers=[GoalEnv], autoreset_mode=mode, num_workers=2, **REACH)
    return GymnasiumVecEnv(vector)


@pytest.mark.parametrize("kind", ["DummyVecEnv", "GymnasiumVecEnv"])
@pytest.mark.parametrize("copies_info", [False, True])
def test_hindsight_replay_trains_on_virtual_goals(kind, copies_info):
    sb3 = pytest.importorskip("stable_baselines3")
    settings = {"n_sampled_goal": 4, "goal_selection_strategy": "future", "copy_info_dict": copies_info}
    model = sb3.SAC(
        "MultiInputPolicy",
        env := vector_of_sb3(kind),
        replay_buffer_class=sb3.HerReplayBuffer,
        replay_buffer_kwargs=settings,
        learning_starts=80,
        batch_size=64,
        policy_kwargs={"net_arch": [16]},
        seed=0,
    )
    before = model.policy.state_dict()["actor.mu.weight"].clone()
    model.learn(120)
    assert not before.equal(model.policy.state_dict()["actor.mu.weight"])
    batch = model.replay_buffer.sample(256)
    achieved, desired = (batch.next_observations[name].numpy() for name in ("achieved_goal", "desired_goal"))
    away = np.linalg.norm(achieved - desired, axis=1)
    np.testing.assert_array_equal(batch.rewards.numpy()[:, 0], np.where(away <= 0.3, 0.0, -1.0))
    assert 0.05 < np.mean(away <= 0.3) < 0.95
    env.close()

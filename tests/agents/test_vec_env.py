from typing import ClassVar
from unittest.mock import Mock

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.envs.registration import EnvSpec, WrapperSpec
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import TimeLimit
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy

from lidarnaut.agents.config import EnvironmentConfig, TrainingConfig
from lidarnaut.agents.evaluation import Evaluator, run_episodes
from lidarnaut.agents.vec_env import GymnasiumVecEnv, make_vec_env, make_vector
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.ids import arguments_of
from lidarnaut.envs.simulation import Twist
from lidarnaut.envs.tasks.explore import Explore

QUICK = EnvironmentConfig(world="rooms", world_size=(6.0, 6.0), control_hz=5.0, time_limit=3.0)


def make(num_envs=3, kind="native", id=QUICK.id, mode=AutoresetMode.SAME_STEP, **arguments):
    arguments = {"physics": "kinematic", "split": "train", "world": "rooms", "world_size": (6.0, 6.0)} | arguments
    if kind == "native":
        return gymnasium.make_vec(id, num_envs, autoreset_mode=mode, **{"num_workers": 0, **arguments})
    return gymnasium.make_vec(id, num_envs, kind, vector_kwargs={"autoreset_mode": mode}, **arguments)


def adapt(*args, **arguments):
    return GymnasiumVecEnv(make(*args, **arguments))


class Limited(LidarEnv):
    def __init__(self, **arguments):
        super().__init__(Explore, **arguments)


class Own(Limited):
    def reward_terms(self, quantities):
        return {"time": 7.0}


def wrapped(**arguments):
    return TimeLimit(Limited(**arguments), 8)


WRAPPER = WrapperSpec("TimeLimit", "gymnasium.wrappers:TimeLimit", {"max_episode_steps": 8})
VECTOR = {"vector_entry_point": "lidarnaut.envs.vector:LidarEnvs", "kwargs": {"task": Explore}}
LIMITED = {
    "package": {"entry_point": LidarEnv, "max_episode_steps": 8, **VECTOR},
    "class": {"entry_point": Limited, "max_episode_steps": 8},
    "own methods": {"entry_point": Own, "max_episode_steps": 8},
    "function": {"entry_point": wrapped},
    "wrappers": {"entry_point": Limited, "additional_wrappers": (WRAPPER,)},
}


@pytest.mark.parametrize("vectorization", ["native", "sync"])
@pytest.mark.parametrize("case", LIMITED)
def test_episodes_that_a_number_of_steps_ends_are_measured_in_trainings(case, vectorization, monkeypatch):
    monkeypatch.setitem(gymnasium.registry, "test/Limited-v0", EnvSpec("test/Limited-v0", **LIMITED[case]))
    arguments_of.cache_clear()
    config = EnvironmentConfig(id="test/Limited-v0", vectorization=vectorization, num_workers=0, **QUICK.arguments)
    env = make_vector(config, "test", 2)
    bar = Mock(n=0)
    for history in run_episodes(env, lambda seen, starts: np.full((2, 2), 0.3, dtype=np.float32), bar=bar):
        assert history.samples["time"][-1] == pytest.approx(1.6)
        assert history.final["end_reason"] == "time_limit"
        assert 0.0 < history.final["map_iou"] < 1.0
    said = [call.args[0] for call in bar.set_postfix_str.call_args_list]
    assert [text.partition(" of ")[0] for text in said] == ["0", "0", "1", "1", "1", "1", "1", "0"]
    env.close()


def test_other_autoresets_are_refused():
    env = make(mode=AutoresetMode.NEXT_STEP)
    with pytest.raises(ValueError, match="SAME_STEP"):
        GymnasiumVecEnv(env)
    env.close()


def test_masked_ppo_learns_and_never_takes_what_is_masked():
    maskable = pytest.importorskip("sb3_contrib", reason="needs the extra `dev`").MaskablePPO
    env = adapt(4, id="lidarnaut/ExploreFrontiers-v0", slam="truth")
    model = maskable("MultiInputPolicy", env, n_steps=24, batch_size=48, n_epochs=2, seed=1)
    before = {name: weight.clone() for name, weight in model.policy.named_parameters()}
    model.learn(192)
    buffer = model.rollout_buffer
    taken = np.take_along_axis(buffer.action_masks, buffer.actions.astype(int).reshape(-1, 1), axis=1)
    assert (taken == 1.0).all()
    assert 0 < buffer.action_masks.mean() < 1
    np.testing.assert_array_equal(buffer.action_masks, buffer.observations["action_mask"])
    assert not all(torch.equal(weight, before[name]) for name, weight in model.policy.named_parameters())
    env.close()


@pytest.mark.parametrize("kind", ["native", "sync", "async"])
def test_sub_environments_can_be_reached(kind):
    env = adapt(3, kind, "lidarnaut/ExploreFrontiers-v0", render_mode="rgb_array")
    env.seed(4)
    masks = env.reset()["action_mask"]
    for found in (env.env_method("action_masks"), env.env.call("action_masks")):
        np.testing.assert_array_equal(found, masks)
    np.testing.assert_array_equal(env.env_method("action_masks", indices=[2]), masks[2:])
    assert env.has_attr("action_masks")
    if kind != "async":  # Gymnasium's processes end at a request for a missing attribute
        assert not env.has_attr("no_such_thing")
    env.set_attr("nickname", "all")
    env.set_attr("nickname", "second", indices=1)
    assert env.get_attr("nickname") == ["all", "second", "all"]
    assert env.get_attr("nickname", indices=[1]) == ["second"]
    with pytest.raises(ValueError, match=r"render can be called in all sub-environments, not in \[0\] alone"):
        env.env_method("render", indices=0)
    assert env.render().std() > 1.0
    env.close()


def test_seeds_count_up_and_hold_for_one_reset():
    env = adapt()
    env.seed(7)
    first, second = env.reset()["scan"], env.reset()["scan"]
    assert (first != second).any()
    env.seed(8)
    np.testing.assert_array_equal(env.reset()["scan"][:2], first[1:])
    env.close()


def test_its_episodes_pass_for_monitored_ones(recwarn):
    env = adapt(control_hz=5.0, time_limit=2.0)
    model = PPO("MultiInputPolicy", env, n_steps=16, seed=0)
    _, lengths = evaluate_policy(model, env, n_eval_episodes=4, return_episode_rewards=True)
    assert lengths == [10] * 4
    assert not [w for w in recwarn if "Monitor" in str(w.message)]
    env.close()


@pytest.mark.parametrize("how", [{"num_workers": 0}, {"num_workers": 3}, {"vectorization": "sync"}])
def test_the_environments_of_several_robots_are_stepped_as_each_for_itself(how):
    several = {"id": "lidarnaut/ReachGoal-v0", "world": "hall", "time_limit": 2.0, "num_workers": 0}
    several["observations"] = ["scan_history", "goal", "motion", "limits"]
    robots = ("jackal", "turtlebot3_burger")
    environment = {**several, **how, "robots": robots}
    config = TrainingConfig(experiment="two", total_steps=1, algorithm="PPO", num_envs=5, environment=environment)
    joined = make_vec_env(config)
    singles = [(EnvironmentConfig(**several, robot=name), count) for name, count in zip(robots, (3, 2))]
    apart = [GymnasiumVecEnv(make_vector(single, "train", count)) for single, count in singles]
    for env, seed in zip((joined, *apart), (7, 7, 10)):
        env.seed(seed)
    first, *others = (env.reset() for env in (joined, *apart))
    np.testing.assert_equal(first, {name: np.concatenate([one[name] for one in others]) for name in first})
    assert len(np.unique(first["limits"], axis=0)) == 2
    ended = 0
    for action in np.random.default_rng(0).uniform(-1, 1, (30, 5, 2)).astype(np.float32):
        seen, rewards, dones, infos = joined.step(action)
        theirs = [env.step(part) for env, part in zip(apart, (action[:3], action[3:]))]
        np.testing.assert_equal(seen, {name: np.concatenate([one[0][name] for one in theirs]) for name in seen})
        np.testing.assert_equal(rewards, np.concatenate([one[1] for one in theirs]))
        np.testing.assert_equal(dones, np.concatenate([one[2] for one in theirs]))
        others = [info for one in theirs for info in one[3]]
        assert [info.keys() for info in infos] == [info.keys() for info in others]
        last, expected = ([info.get("terminal_observation") for info in some] for some in (infos, others))
        np.testing.assert_equal(last, expected)
        ended += dones.sum()
    assert ended >= 5
    assert [one.name for one in joined.get_attr("robot_params", [0, 2, 4])] == ["jackal"] * 2 + ["turtlebot3_burger"]
    joined.close()
    for env in apart:
        env.close()


def test_robots_that_cannot_be_trained_together_are_refused():
    config = {"experiment": "two", "total_steps": 1, "algorithm": "PPO", "num_envs": 2}
    environment = {"robots": ("turtlebot3_burger", "jackal"), "world": "rooms", "num_workers": 0}
    with pytest.raises(ValueError, match=r"variants: {'robot': 'jackal'} has observations or actions unlike"):
        make_vec_env(TrainingConfig(**config, environment=environment))
    with pytest.raises(ValueError, match="num_envs is 1, fewer than the 2 robots"):
        make_vec_env(TrainingConfig(**config | {"num_envs": 1}, environment=environment))


class Standing:
    robots: ClassVar[list[str]] = []

    def reset(self, robot, control_period, rng):
        self.robots.append(robot.name)

    def act(self, reading, belief):
        return Twist(0.0, 0.0)


def test_evaluations_take_the_first_robot_or_their_own(tmp_path):
    environment = {"id": "lidarnaut/ReachGoal-v0", "world": "hall", "robots": ["turtlebot3_burger", "jackal"]}
    environment |= {"observations": ["goal"], "time_limit": 0.2}
    Standing.robots.clear()
    for own in ({}, {"robot": "jackal"}):
        evaluation = {"episodes": 1, "environment": own}
        config = {"experiment": "two", "total_steps": 1, "algorithm": "PPO", "evaluation": evaluation}
        evaluator = Evaluator(TrainingConfig(**config, environment=environment))
        for _ in range(2):  # the second time, from the folder
            (folder := tmp_path / str(len(own))).mkdir(exist_ok=True)
            evaluator.references({"tests.agents.test_vec_env:Standing": "standing"}, folder, progress=False)
        evaluator.close()
    assert Standing.robots == ["turtlebot3_burger", "jackal"]

"""Results are equal to those of Gymnasium's `SyncVectorEnv`, byte by byte."""

from dataclasses import dataclass
from functools import partial

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import FlattenObservation, StickyAction, TimeLimit

from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.task import Rewards
from lidarnaut.envs.tasks.explore import Explore
from lidarnaut.envs.tasks.reach_goal import ReachGoal
from lidarnaut.envs.vector import LidarEnvs, LidarVectorEnv
from tests.rollouts import assert_same_info
from tests.vector.pairs import both

QUICK = {"world": "rooms", "world_size": (6.0, 6.0), "physics": "kinematic", "control_hz": 5.0, "slam": "odometry"}
MODES = [(AutoresetMode.NEXT_STEP, 2), (AutoresetMode.SAME_STEP, 1), (AutoresetMode.DISABLED, 3)]
WRAPPERS = partial(StickyAction, repeat_action_probability=0.5), partial(TimeLimit, max_episode_steps=4)
VALUES = {
    "whole, then not": lambda k: 0.25 * k if k else 0,
    "bool, then int": lambda k: k if k > 1 else False,
    "text": lambda k: "a" * 9 * k,
    "text that ends with a zero": lambda k: "a\0"[: 1 + k % 2],
    "None, then float": lambda k: 1.5 if k > 1 else None,
    "list": lambda k: [0.0] * k,
    "dict": lambda k: {"a": k, "b": {"c": float(k), "d": "x" * k}},
    "dict that grows": lambda k: {"a": 1.0} | ({"b": 2} if k > 2 else {}),
    "dict of numbers": lambda k: {"a": 0.5 * k, "b": k, "c": k > 2},
    "dict with None": lambda k: {"a": None if k % 2 else 1.0},
    "empty dict": lambda k: {},
    "array": lambda k: k * np.arange(3),
    "array without axes": lambda k: np.array(0.5 * k),
    "array of objects": lambda k: np.array([None, k], dtype=object),
    "array of texts": lambda k: np.array(["ab"]),
    "float32": lambda k: np.float32(0.1 * k),
    "int8": lambda k: np.int8(k),
    "uint64": lambda k: np.uint64(2**64 - 1 - k),
    "NumPy's bool": lambda k: np.bool_(k > 2),
    "set": lambda k: frozenset([k]),
    "date": lambda k: np.datetime64("2026-01-01"),
    "NaN": lambda k: np.nan if k % 2 else -0.0,
}


@dataclass(kw_only=True, eq=False)
class Telling(Explore):
    """Has metrics of all kinds, including temporary and intermittent ones, and counts its calls."""

    chosen: tuple = tuple(VALUES)
    ends_after: int = 5

    def reset(self, simulator, robots, rng, options):
        self.count, self.asked, self.first = 0, [0, 0], int(rng.integers(3))
        return super().reset(simulator, robots, rng, options)

    def update(self, simulator, robots, period):
        super().update(simulator, robots, period)
        self.count += 1
        self.end_reason = "told" if self.count == self.ends_after + self.first else None

    def quantities(self):
        self.asked[0] += 1
        time = np.float32(0.2) if self.count % 2 else self.count
        return super().quantities() | {"time": time}

    def metrics(self):
        self.asked[1] += 1
        told = {name: VALUES[name](self.count) for name in self.chosen} | {"asked": tuple(self.asked)}
        told |= {"early": 1.0} if self.count < 3 else {"late": self.count}
        return super().metrics() | told | ({"now and then": 0.5} if (self.count + self.first) % 3 else {})


class Fading(Rewards):
    changes = {"fading": 1}

    def terms(self, quantities):
        self.count = getattr(self, "count", 0) + 1
        terms = super().terms({**quantities, "fading": 1.0 / self.count})
        return terms | ({"third": 1} if self.count % 3 == 0 else {})


class Silent(Rewards):
    def terms(self, quantities):
        return {}


def compare(id, arguments, mode, num_workers, wrappers=(), steps=24):
    """Assert equal outputs of a vector environment and single ones; return the number of ended episodes."""

    def call(method, *values, **named):
        (*ours, our_info), (*theirs, their_info) = (getattr(env, method)(*values, **named) for env in envs)
        assert data_equivalence(ours, theirs)
        assert_same_info(our_info, their_info)
        return theirs

    num_ended, ended = 0, np.zeros(3, dtype=bool)
    with both(id, mode, num_workers, arguments, wrappers) as envs:
        call("reset", seed=5)
        envs[0].action_space.seed(0)
        for k in range(steps):
            if mode == AutoresetMode.DISABLED and ended.any():
                call("reset", options={"reset_mask": ended})
            if k in (7, 15):
                call("reset", seed=[k, None, None], options={"reset_mask": np.array([True, False, True])})
            _, _, terminated, truncated = call("step", envs[0].action_space.sample())
            ended = terminated | truncated
            num_ended += ended.sum()
    return num_ended


@pytest.mark.parametrize(("mode", "num_workers"), MODES)
def test_info_follows_gymnasiums_rules_for_any_values_and_keys(mode, num_workers):
    assert compare("lidarnaut/Explore-v0", {**QUICK, "task": Telling}, mode, num_workers) >= 6


@pytest.mark.parametrize("num_workers", [1, 2])
def test_arrays_may_change_their_shapes(num_workers):
    VALUES["growing"] = lambda k: np.zeros(1 + k // 4)
    arguments = {**QUICK, "task": Telling, "chosen": ("growing", "list"), "ends_after": 99}
    env = gymnasium.make_vec("lidarnaut/Explore-v0", 2, num_workers=num_workers, **arguments)
    env.reset(seed=0)
    for k in range(1, 10):
        info = env.step(np.zeros((2, 2)))[4]
        assert info["growing"].shape == (2, 1 + k // 4)
        assert info["list"].tolist() == [[0.0] * k] * 2
    env.close()


@pytest.mark.parametrize(
    ("id", "reward", "mode"),
    [
        ("Explore", Fading, 0),
        ("ReachGoal", Fading, 1),
        ("Explore", Silent, 1),
        ("ReachGoal", Silent, 2),
        ("Explore", {"time": -1}, 2),
        ("ReachGoal", {"time": np.float32(-0.1)}, 0),
    ],
)
def test_rewards_are_asked_for_once_and_may_be_of_any_kind(id, reward, mode):
    compare(f"lidarnaut/{id}-v0", {**QUICK, "reward": reward, "time_limit": 1.4}, *MODES[mode])


@pytest.mark.parametrize(("mode", "num_workers"), MODES)
def test_wrappers_that_draw_and_keep_actions_do_as_in_single_environments(mode, num_workers):
    assert compare("lidarnaut/Explore-v0", {**QUICK, "time_limit": 1.4}, mode, num_workers, WRAPPERS) >= 6


@pytest.mark.parametrize(
    ("id", "mode", "num_workers"), [("Explore", *MODES[0]), ("ReachGoal", *MODES[1]), ("ExploreFrontiers", *MODES[2])]
)
def test_info_may_have_the_same_keys_in_every_step(id, mode, num_workers):
    arguments = {**QUICK, "fixed_info": True, "time_limit": 6.0 if id == "ExploreFrontiers" else 1.4}
    compare(f"lidarnaut/{id}-v0", arguments, mode, num_workers)
    env = gymnasium.make(f"lidarnaut/{id}-v0", **arguments)
    _, first = env.reset(seed=0)
    infos = [first]
    while not infos[-1]["end_reason"]:
        infos.append(env.step(env.action_space.sample())[4])
    kinds = [{name: type(value) for name, value in info.items()} for info in infos]
    for info, kind in zip(infos[:-1], kinds, strict=False):
        assert kind == kinds[-1]
        assert info["end_reason"] == ""
        assert info["map_iou" if "Explore" in id else "barn_metric"] == 0.0
    assert infos[-1]["end_reason"] == "time_limit"


def test_episodes_may_end_by_the_task_and_by_the_number_of_steps_at_once():
    arguments = {**QUICK, "task": Telling, "chosen": ()}
    single = TimeLimit(LidarEnv(**arguments), 1)
    single.reset(seed=1)
    steps = single.unwrapped.task.ends_after + single.unwrapped.task.first
    for env in (
        gymnasium.make("lidarnaut/Explore-v0", max_episode_steps=steps, **arguments),
        gymnasium.make_vec("lidarnaut/Explore-v0", 1, max_episode_steps=steps, **arguments),
    ):
        env.reset(seed=1)
        flags = [np.ravel(env.step(np.zeros(env.action_space.shape))[2:4]).tolist() for _ in range(steps)]
        assert flags == [[False, False]] * (steps - 1) + [[True, True]]
        env.close()


def limited(**arguments):
    return TimeLimit(LidarEnv(**arguments), 7)


LIMITS = [(limited, np.int64(3), (), 3), (limited, 9, (), 7), (LidarEnv, 7, [FlattenObservation], 7)]


@pytest.mark.parametrize(("make", "limit", "wrappers", "steps"), [*LIMITS, (LidarEnv, -1, [FlattenObservation], 10)])
def test_the_number_of_steps_is_limited_by_the_lowest_limit_and_minus_one_is_none(make, limit, wrappers, steps):
    arguments = {"max_episode_steps": limit, "env_wrappers": wrappers, "time_limit": 2.0, **QUICK}
    env = LidarVectorEnv(make, 2, task=Explore, num_workers=1, **arguments)
    env.reset(seed=0)
    for k in range(1, steps + 1):
        observation, _, _, truncated, info = env.step(np.zeros((2, 2)))
        assert observation in env.observation_space
        assert truncated.tolist() == [k == steps] * 2
    assert wrappers or make is limited or info["end_reason"].tolist() == ["time_limit"] * 2
    env.close()


@pytest.mark.parametrize("task", [Explore, ReachGoal])
def test_generators_and_their_seeds_can_be_asked_for(task):
    ours = LidarEnvs(3, task=task, num_workers=2, **QUICK)
    theirs = SyncVectorEnv([partial(LidarEnv, task, **QUICK)] * 3)
    for seed in (np.uint8(254), np.int8(126), np.uint64(2**64 - 2), 2**63, 2**70, [5, 2**65, np.int16(7)]):
        seeds = list(map(int, seed)) if isinstance(seed, list) else [int(seed) + i for i in range(3)]
        observations = [ours.reset(seed=seed)[0], theirs.reset(seed=seeds)[0]]
        assert data_equivalence(*observations)
        assert ours.np_random_seed == theirs.np_random_seed == tuple(seeds)
        states = [[rng.bit_generator.state for rng in env.np_random] for env in (ours, theirs)]
        assert data_equivalence(*states)
    ours.reset(seed=[1, None, 2])
    assert ours.np_random_seed == (1, 2**65, 2)
    with pytest.raises(gymnasium.error.Error, match="greater or equal to zero, actual value: -1"):
        ours.reset(seed=-1)
    ours.close()

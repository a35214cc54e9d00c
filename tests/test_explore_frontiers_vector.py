import time
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from envs.explore_frontiers import ExploreFrontiersEnv
from envs.explore_frontiers_vector import ExploreFrontiersVectorEnv
from envs.frontier_choice import SurveyParams
from envs.frontier_choice.tables import SurveyTables
from envs.navigation import COST_LETHAL
from envs.robots import load_robot
from tests.lanes import assert_same, step_both

BURGER = load_robot("turtlebot3_burger")
QUICK = {"world": "rooms", "world_size": (6.0, 6.0), "time_limit": 14.0}
PLACES = {
    "rooms": {},
    "to the end": {"time_limit": None, "target_coverage": 1.0, "max_candidates": 4},
    "movers": {"world": "turtlebot3_stage_4", "world_size": None, "slam": "truth"},
    "lost beams": {"robot": replace(BURGER, lidar=replace(BURGER.lidar, dropout=0.1))},
    "growing map": {"world": "tugbot_warehouse", "world_size": None, "robot": "tugbot", "slam": "odometry"},
}


def actions_of(num_envs, steps, num_actions, seed=0):
    """Mostly near candidates, now and then any number: also without a candidate."""
    rng = np.random.default_rng(seed)
    return np.where(rng.random((steps, num_envs)) < 0.8, 0, rng.integers(0, num_actions, (steps, num_envs)))


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.parametrize("place", PLACES)
def test_lanes_equal_single_environments_bit_for_bit(place, mode):
    arguments = {**QUICK, **PLACES[place]}
    ours = ExploreFrontiersVectorEnv(3, autoreset_mode=mode, num_threads=2, **arguments)
    theirs = SyncVectorEnv([lambda: ExploreFrontiersEnv(physics="kinematic", **arguments)] * 3, autoreset_mode=mode)
    reasons = set()
    actions = actions_of(3, 200 if place == "to the end" else 25, ours.single_action_space.n)
    for _, info in step_both(ours, theirs, actions):
        last = info.get("final_info", info)
        reasons |= set(last.get("end_reason", [])) - {None}
    assert ("no_reachable_frontier" if place == "to the end" else "time_limit") in reasons
    ours.close()


def test_robots_that_can_stand_nowhere_end_stuck(monkeypatch):
    tables = SurveyTables.of(SurveyParams(inflation=5.0), 0.1, 2, 0.05)
    nowhere = tables._replace(costs=np.full_like(tables.costs, COST_LETHAL))
    monkeypatch.setattr("envs.frontier_choice.choice.tables_of", lambda *_: (nowhere,))
    single, lanes = ExploreFrontiersEnv(physics="kinematic", **QUICK), ExploreFrontiersVectorEnv(2, **QUICK)
    observation, _ = single.reset(seed=1)
    lanes.reset(seed=1)
    assert not observation["action_mask"].any()
    *_, terminated, truncated, info = single.step(np.int64(0))
    assert (terminated, truncated, info["end_reason"]) == (True, False, "stuck")
    *_, lane_terminated, _, lane_info = lanes.step(np.zeros(2, dtype=np.int64))
    assert lane_terminated.all()
    assert lane_info["end_reason"].tolist() == ["stuck", "stuck"]
    lanes.close()


def test_make_vec_gives_lanes_and_episode_statistics():
    env = gymnasium.make_vec("lidarnaut/ExploreFrontiers-v0", num_envs=2, world="rooms", world_size=(6.0, 6.0))
    assert isinstance(env.unwrapped, ExploreFrontiersVectorEnv)
    assert env.observation_space["candidates"].shape == (2, 24, 10)
    env.close()
    env = ExploreFrontiersVectorEnv(2, max_episode_steps=5, **{**QUICK, "time_limit": None})
    env.reset(seed=0)
    total = np.zeros(2)
    for step in range(5):
        observation, reward, _, truncated, info = env.step(np.zeros(2, dtype=np.int64))
        assert observation in env.observation_space
        total += reward
        np.testing.assert_allclose(reward, sum(info["rewards"][name] for name in env.envs[0].weights.names()))
        np.testing.assert_array_equal(env.action_masks(), info["action_mask"] == 1)
        assert ("episode" in info) == truncated.all() == (step == 4)
    np.testing.assert_allclose(info["episode"]["r"], total)
    assert info["episode"]["l"].tolist() == [5, 5]
    np.testing.assert_allclose(info["episode"]["t"], info["time"])
    env.close()


def test_observations_are_fresh_and_a_reset_repeats():
    env = ExploreFrontiersVectorEnv(2, **QUICK)
    first, _ = env.reset(seed=3)
    kept = {key: value.copy() for key, value in first.items()}
    for action in actions_of(2, 10, 24):
        env.step(action)
    assert_same(first, kept)
    again, _ = env.reset(seed=3)
    assert_same(again, kept)
    env.close()


def test_disabled_autoreset_resets_by_mask():
    env = ExploreFrontiersVectorEnv(2, autoreset_mode=AutoresetMode.DISABLED, **QUICK)
    observation, _ = env.reset(seed=0)
    stay = np.zeros(2, dtype=np.int64)
    ended = np.zeros(2, dtype=bool)
    while not ended.any():
        observation, _, terminated, truncated, _ = env.step(stay)
        ended = terminated | truncated
    with pytest.raises(ValueError, match="reset_mask"):
        env.step(stay)
    after, info = env.reset(options={"reset_mask": ended})
    np.testing.assert_array_equal(after["candidates"][~ended], observation["candidates"][~ended])
    assert (info["time"][ended] == 0.0).all()
    assert (info["outcome"][ended] == "reset").all()
    env.close()


@pytest.mark.parametrize(
    "actions", [np.zeros(3, dtype=int), np.zeros((2, 1), dtype=int), np.zeros(2), np.array([0, 24]), np.array([-1, 0])]
)
def test_bad_actions_are_refused(actions):
    env = ExploreFrontiersVectorEnv(2, **QUICK)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="actions must"):
        env.step(actions)
    env.close()


@pytest.mark.parametrize(
    ("arguments", "culprit"),
    [({"num_envs": 0}, "num_envs"), ({"physics": "bullet"}, "physics"), ({"max_candidates": 0}, "max_candidates")],
)
def test_bad_arguments_are_named(arguments, culprit):
    with pytest.raises(ValueError, match=culprit):
        ExploreFrontiersVectorEnv(**{"num_envs": 1, **QUICK, **arguments})


def test_a_step_that_fails_leaves_no_thread_at_work(monkeypatch):
    env = ExploreFrontiersVectorEnv(2, num_threads=2, **QUICK)
    env.reset(seed=0)
    over = []

    def decide(thread, *arguments):
        if thread == 0:
            raise RuntimeError("lane 0 breaks")
        time.sleep(0.2)
        over.append(thread)

    monkeypatch.setattr(env, "_decide", decide)
    with pytest.raises(RuntimeError, match="lane 0 breaks"):
        env.step(np.zeros(2, dtype=np.int64))
    assert over == [1]
    env.close()

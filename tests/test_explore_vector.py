import time

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from envs.explore import ExploreEnv
from envs.explore_vector import ExploreVectorEnv
from tests.lanes import assert_same, step_both

QUICK = {"world": "rooms", "world_size": (6.0, 6.0), "control_hz": 5.0, "time_limit": 3.0}
PLACES = {
    "rooms": {},
    "movers": {"world": "turtlebot3_stage_4", "world_size": None, "slam": "truth"},
    "growing map": {"world": "tugbot_warehouse", "world_size": None, "robot": "tugbot", "slam": "odometry"},
}


def actions_of(num_envs, steps, seed=0):
    actions = np.random.default_rng(seed).uniform(-1, 1, (steps, num_envs, 2)).astype(np.float32)
    actions[..., 0] = np.abs(actions[..., 0])
    return actions


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.parametrize("place", PLACES)
def test_lanes_equal_single_environments_bit_for_bit(place, mode):
    arguments = {**QUICK, **PLACES[place]}
    ours = ExploreVectorEnv(3, autoreset_mode=mode, num_threads=2, **arguments)
    theirs = SyncVectorEnv([lambda: ExploreEnv(physics="kinematic", **arguments)] * 3, autoreset_mode=mode)
    ended = 0
    for (_, _, truncated), _ in step_both(ours, theirs, actions_of(3, 40)):
        ended += np.count_nonzero(truncated)
    assert ended >= 6
    ours.close()


def test_the_map_grows_in_lanes():
    # Facing the far end of a hall of 50 m, where the lidar reaches out of a map of 20 m after a few metres.
    env = ExploreVectorEnv(1, **{**QUICK, **PLACES["growing map"]}, start=(0.0, 0.0, 1.57))
    env.reset(seed=0)
    before = env.envs[0].slam.map.words.size
    for _ in range(14):
        env.step(np.array([[1.0, 0.0]], dtype=np.float32))
    assert env.envs[0].slam.map.words.size >= 2 * before
    env.close()


def test_make_vec_gives_lanes_and_episode_statistics():
    env = gymnasium.make_vec("lidarnaut/ExploreRooms-v0", num_envs=4, world_size=(6.0, 6.0), control_hz=5.0)
    assert isinstance(env.unwrapped, ExploreVectorEnv)
    assert env.spec.id == "lidarnaut/ExploreRooms-v0"
    assert env.observation_space["map_near"].shape == (4, 3, 40, 40)
    env.close()
    env = ExploreVectorEnv(2, max_episode_steps=7, **QUICK)
    env.reset(seed=0)
    total = np.zeros(2)
    for step, action in enumerate(actions_of(2, 7)):
        observation, reward, _, truncated, info = env.step(action)
        assert observation in env.observation_space
        total += reward
        assert ("episode" in info) == truncated.any() == (step == 6)
    np.testing.assert_allclose(info["episode"]["r"], total)
    assert info["episode"]["l"].tolist() == [7, 7]
    np.testing.assert_allclose(info["episode"]["t"], 1.4)
    assert info["end_reason"].tolist() == ["time_limit"] * 2
    env.close()


def test_observations_are_fresh_and_a_reset_repeats():
    env = ExploreVectorEnv(2, **QUICK)
    first, _ = env.reset(seed=3)
    kept = {key: value.copy() for key, value in first.items()}
    for action in actions_of(2, 25):
        env.step(action)
    assert_same(first, kept)
    again, _ = env.reset(seed=3)
    assert_same(again, kept)
    env.close()


def test_disabled_autoreset_resets_by_mask():
    env = ExploreVectorEnv(2, autoreset_mode=AutoresetMode.DISABLED, **QUICK)
    env.reset(seed=0)
    for action in actions_of(2, 15):
        observation, _, _, truncated, _ = env.step(action)
    assert truncated.all()
    with pytest.raises(ValueError, match="reset_mask"):
        env.step(action)
    after, info = env.reset(options={"reset_mask": np.array([True, False])})
    np.testing.assert_array_equal(after["scan"][1], observation["scan"][1])
    assert info["time"].tolist() == pytest.approx([0.0, 3.0])
    env.close()


@pytest.mark.parametrize(
    ("arguments", "culprit"),
    [
        ({"num_envs": 0}, "num_envs"),
        ({"physics": "bullet"}, "physics"),
        ({"render_mode": "rgb_array"}, "render_mode"),
        ({"num_threads": 0}, "num_threads"),
        ({"max_episode_steps": 0}, "max_episode_steps"),
    ],
)
def test_bad_arguments_are_named(arguments, culprit):
    with pytest.raises(ValueError, match=culprit):
        ExploreVectorEnv(**{"num_envs": 1, **QUICK, **arguments})


@pytest.mark.parametrize("actions", [np.zeros((1, 2)), np.full((2, 2), np.nan), np.full((2, 2), 1.5)])
def test_bad_actions_are_refused(actions):
    env = ExploreVectorEnv(2, **QUICK)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="actions must"):
        env.step(actions)
    env.close()


def test_state_stays_under_a_mebibyte_per_lane():
    env = ExploreVectorEnv(4, world="rooms", num_threads=1)
    env.reset(seed=0)
    assert env.envs[0].slam.map.words.shape == (400, 400)
    assert env.state_bytes / 4 < 2**20
    env.close()


def test_a_step_that_fails_leaves_no_thread_at_work(monkeypatch):
    env = ExploreVectorEnv(2, num_threads=2, **QUICK)
    env.reset(seed=0)
    over = []

    def step_share(thread, *arguments):
        if thread == 0:
            raise RuntimeError("lane 0 breaks")
        time.sleep(0.2)
        over.append(thread)

    monkeypatch.setattr(env, "_step_share", step_share)
    with pytest.raises(RuntimeError, match="lane 0 breaks"):
        env.step(np.zeros((2, 2), dtype=np.float32))
    assert over == [1]
    env.close()

import copy
import gc
import multiprocessing
import os
import pickle
import re
import time
from functools import partial

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import NormalizeReward, RecordEpisodeStatistics, RecordVideo

from envs.core import LidarEnv
from envs.tasks.explore import Explore, ExploreTeam
from envs.vector import LidarEnvs, LidarVectorEnv
from tests.side_by_side import assert_same, step_both

explore_envs, team_envs = partial(LidarEnvs, task=Explore), partial(LidarEnvs, task=ExploreTeam)
QUICK = {"world": "rooms", "world_size": (6.0, 6.0), "control_hz": 5.0, "time_limit": 3.0}
CASES = {
    "rooms": ("lidarnaut/Explore-v0", QUICK),
    "movers": ("lidarnaut/Explore-v0", {"world": "turtlebot3_stage_4", "slam": "truth", "time_limit": 3.0}),
    "growing map": (
        "lidarnaut/Explore-v0",
        {"world": "tugbot_warehouse", "robot": "tugbot", "slam": "odometry", "time_limit": 3.0},
    ),
    "key scans": ("lidarnaut/Explore-v0", {**QUICK, "slam": "hector", "time_limit": 8.0}),
    "gmapping": ("lidarnaut/Explore-v0", {**QUICK, "slam": "gmapping"}),
    "graph": ("lidarnaut/Explore-v0", {**QUICK, "slam": "graph"}),
    "bullet": ("lidarnaut/Explore-v0", {**QUICK, "physics": "bullet"}),
    "frontiers": ("lidarnaut/ExploreFrontiers-v0", {**QUICK, "time_limit": 15.0}),
    "team": ("lidarnaut/ExploreTeam-v0", {**QUICK, "num_robots": 2}),
    "navigate": ("lidarnaut/Navigate-v0", QUICK),
    "track": ("lidarnaut/Track-v0", {"time_limit": 1.5, "map_resolution": 0.1}),
}


def actions_of(env, steps, seed=0):
    env.action_space.seed(seed)
    for _ in range(steps):
        actions = env.action_space.sample()
        yield np.abs(actions) if actions.dtype == np.float32 else actions


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.parametrize("case", CASES)
def test_sub_environments_equal_single_ones_bit_for_bit(case, mode):
    id, arguments = CASES[case]
    arguments = {"physics": "kinematic", **arguments}
    ours = gymnasium.make_vec(id, 3, num_workers=2, autoreset_mode=mode, **arguments)
    theirs = SyncVectorEnv([lambda: gymnasium.make(id, **arguments).unwrapped] * 3, autoreset_mode=mode)
    ended = 0
    for (_, terminated, truncated), _ in step_both(ours, theirs, actions_of(ours, 56)):
        ended += np.count_nonzero(terminated | truncated)
    assert ended >= 3
    ours.close()


@pytest.mark.parametrize("how", [{"num_workers": 0}, {"num_workers": 3}, {"num_workers": 2, "context": "forkserver"}])
def test_the_number_of_workers_and_how_they_start_change_nothing(how):
    envs = [explore_envs(3, **arguments, **QUICK) for arguments in (how, {"num_workers": 2})]
    for _ in step_both(*envs, actions_of(envs[0], 20)):
        pass
    for env in envs:
        env.close()


def test_make_vec_gives_shards_of_every_id():
    ids = [id for id in gymnasium.registry if id.startswith("lidarnaut/")]
    for id in ids:
        assert gymnasium.registry[id].vector_entry_point is not None
    env = gymnasium.make_vec("lidarnaut/ExploreRooms-v0", num_envs=4, world_size=(6.0, 6.0), control_hz=5.0)
    assert isinstance(env.unwrapped, LidarVectorEnv)
    assert env.spec.id == "lidarnaut/ExploreRooms-v0"
    assert env.observation_space["map_near"].shape == (4, 3, 40, 40)
    env.close()


def test_max_episode_steps_truncates():
    env = explore_envs(2, max_episode_steps=7, **QUICK)
    env.reset(seed=0)
    for step, action in enumerate(actions_of(env, 7)):
        observation, _, _, truncated, info = env.step(action)
        assert observation in env.observation_space
        assert truncated.all() == truncated.any() == (step == 6) == ("end_reason" in info)
    assert info["end_reason"].tolist() == ["time_limit"] * 2
    env.close()


def test_observations_are_fresh_and_a_reset_repeats():
    env = explore_envs(2, **QUICK)
    first, _ = env.reset(seed=3)
    kept = {key: value.copy() for key, value in first.items()}
    for action in actions_of(env, 25):
        env.step(action)
    assert_same(first, kept)
    again, _ = env.reset(seed=3)
    assert_same(again, kept)
    env.close()


def test_disabled_autoreset_resets_by_mask():
    env = explore_envs(2, autoreset_mode=AutoresetMode.DISABLED, **QUICK)
    env.reset(seed=0)
    for action in actions_of(env, 15):
        observation, _, _, truncated, _ = env.step(action)
    assert truncated.all()
    with pytest.raises(gymnasium.error.ResetNeeded, match="reset_mask"):
        env.step(action)
    after, info = env.reset(options={"reset_mask": np.array([True, False])})
    np.testing.assert_array_equal(after["scan"][1], observation["scan"][1])
    assert info["time"].tolist() == pytest.approx([0.0, 3.0])
    env.close()


def test_gymnasiums_vector_wrappers_work():
    env = NormalizeReward(RecordEpisodeStatistics(explore_envs(2, **QUICK)))
    env.reset(seed=0)
    lengths = []
    for action in actions_of(env, 35):
        *_, info = env.step(action)
        lengths += info["episode"]["l"][info["_episode"]].tolist() if "episode" in info else []
    assert lengths == [15] * 4
    env.close()


def test_videos_are_recorded(tmp_path):
    pytest.importorskip("moviepy")
    env = RecordVideo(explore_envs(2, render_mode="rgb_array", **QUICK), str(tmp_path), video_length=4)
    env.reset(seed=0)
    for action in actions_of(env, 6):
        env.step(action)
    env.close()
    assert list(tmp_path.glob("*.mp4"))


@pytest.mark.parametrize("num_workers", [0, 2])
def test_render_call_and_attributes_reach_every_sub_environment(num_workers):
    env = explore_envs(3, num_workers=num_workers, render_mode="rgb_array", **QUICK)
    env.reset(seed=0)
    frames = env.render()
    assert len(frames) == 3
    assert not np.array_equal(frames[0], frames[1])
    assert env.get_attr("time_limit") == (3.0, 3.0, 3.0)
    env.set_attr("time_limit", [1.0, 2.0, 3.0])
    assert env.get_attr("time_limit") == (1.0, 2.0, 3.0)
    env.set_attr("time_limit", 9.0)
    assert env.call("get_wrapper_attr", "time_limit") == (9.0, 9.0, 9.0)
    with pytest.raises(ValueError, match="values"):
        env.set_attr("time_limit", [1.0, 2.0])
    env.close()


@pytest.mark.parametrize(
    ("arguments", "culprit"),
    [
        ({"num_envs": 0}, "num_envs"),
        ({"num_envs": 1.5}, "num_envs must be whole and from 1 to 100,000, got 1.5"),
        ({"num_envs": 10**7}, "num_envs must be whole and from 1 to 100,000"),
        ({"num_workers": 1.5}, "num_workers must be whole"),
        ({"max_episode_steps": 1.5}, "max_episode_steps must be whole"),
        ({"render_mode": "human"}, "render_mode"),
        ({"num_workers": -1}, "num_workers"),
        ({"max_episode_steps": 0}, "max_episode_steps"),
    ],
)
def test_bad_arguments_are_named(arguments, culprit):
    with pytest.raises(ValueError, match=culprit):
        explore_envs(**{"num_envs": 1, **QUICK, **arguments})


@pytest.mark.parametrize(
    ("kind", "actions", "message"),
    [
        (explore_envs, np.zeros((1, 2)), "have shape"),
        (explore_envs, np.full((2, 2), np.nan), r"be finite.*sub-environment 0$"),
        (explore_envs, np.full((2, 2), 1.5), r"be finite.*sub-environment 0; clip_actions=True clips"),
        (team_envs, np.full((2, 2, 2), 1.5), r"be finite(.|\n)*sub-environment 0; clip_actions=True clips"),
    ],
)
def test_bad_actions_are_refused(kind, actions, message):
    env = kind(2, num_workers=1, **QUICK)
    env.reset(seed=0)
    with pytest.raises(ValueError, match=f"actions must {message}"):
        env.step(actions)
    env.close()


def test_actions_can_be_clipped():
    clipped, inside = explore_envs(2, clip_actions=True, **QUICK), explore_envs(2, **QUICK)
    clipped.reset(seed=0)
    inside.reset(seed=0)
    for action in actions_of(inside, 5):
        wide = np.where(np.abs(action) > 0.5, 3.0 * action, action).astype(np.float32)
        assert_same(clipped.step(wide)[0], inside.step(wide.clip(-1.0, 1.0))[0])
    clipped.close()
    inside.close()


@pytest.mark.parametrize("num_workers", [0, 2])
def test_errors_of_sub_environments_reach_the_caller(num_workers):
    env = explore_envs(2, num_workers=num_workers, **QUICK)
    with pytest.raises(ValueError, match="unknown options"):
        env.reset(options={"weather": "rain"})
    env.reset(seed=0)
    with pytest.raises(AttributeError, match="no_such_thing"):
        env.get_attr("no_such_thing")
    env.step(env.action_space.sample())
    env.close()


def test_a_worker_that_dies_is_an_error():
    env = explore_envs(2, num_workers=2, **QUICK)
    env.reset(seed=0)
    for child in multiprocessing.active_children():
        child.kill()
        child.join()
    with pytest.raises(RuntimeError, match="worker process died"):
        env.step(env.action_space.sample())
    env.close()


def test_workers_end_at_once_when_closed():
    env = explore_envs(3, num_workers=3, **QUICK)
    env.reset(seed=0)
    began = time.monotonic()
    env.close()
    assert time.monotonic() - began < 5.0  # waiting for one worker alone would take ten


@pytest.mark.parametrize("num_workers", [0, 2])
def test_copies_are_refused_and_leave_the_original_alone(num_workers):
    env = explore_envs(np.int64(2), num_workers=num_workers, **QUICK)
    env.reset(seed=0)
    for copied in (copy.copy, copy.deepcopy, pickle.dumps):
        with pytest.raises(TypeError, match="cannot be copied or pickled"):
            copied(env)
    gc.collect()
    env.step(np.zeros((2, 2)))
    env.close()


def test_seeds_and_options_are_numbers_and_mappings():
    env = explore_envs(2, num_workers=0, **QUICK)
    first = env.reset(seed=np.array([1, 2]))[0]
    assert_same(env.reset(seed=[1, 2])[0], first)
    for wrong in (1.5, True, [1], "a", "ab", (1.5, 2.5), np.array(3)):
        with pytest.raises(
            ValueError, match=f"seed must be one whole number or 2 of them, got {re.escape(repr(wrong))}"
        ):
            env.reset(seed=wrong)
    for wrong in (5, "a"):
        with pytest.raises(ValueError, match=f"options must map names to values, got {wrong!r}"):
            env.reset(options=wrong)
        with pytest.raises(ValueError, match=f"options must map names to values, got {wrong!r}"):
            LidarEnv(Explore, **QUICK, physics="kinematic").reset(options=wrong)
    env.close()


class SlowlyPrepared(LidarEnv):
    """Takes a while to prepare an episode, and says when it does."""

    is_preparing = False

    def prepare(self):
        type(self).is_preparing = True
        time.sleep(0.5)
        type(self).is_preparing = False


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_no_process_is_forked_while_an_episode_is_being_prepared():
    env = LidarVectorEnv(SlowlyPrepared, 1, task=Explore, num_workers=1, physics="kinematic", **QUICK)
    env.reset(seed=0)
    deadline = time.monotonic() + 5.0
    while not SlowlyPrepared.is_preparing and time.monotonic() < deadline:
        time.sleep(0.01)
    assert SlowlyPrepared.is_preparing
    if (child := os.fork()) == 0:
        os._exit(int(SlowlyPrepared.is_preparing))
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    env.close()


@pytest.mark.parametrize("num_workers", [0, 2])
def test_calls_out_of_order_are_refused_by_gymnasiums_errors(num_workers):
    env, actions = explore_envs(2, num_workers=num_workers, **QUICK), np.zeros((2, 2))
    with pytest.raises(gymnasium.error.ResetNeeded, match="no episodes have begun"):
        env.step(actions)
    with pytest.raises(gymnasium.error.ResetNeeded, match="first reset must start all"):
        env.reset(options={"reset_mask": np.array([True, False])})
    env.reset(seed=0)
    with pytest.raises(ValueError, match="atlantis"):
        env.reset(options={"world": "atlantis"})
    with pytest.raises(gymnasium.error.ResetNeeded, match="no episodes have begun"):
        env.step(actions)
    env.reset(seed=0)
    env.step(actions)
    env.close()
    for call in (env.reset, lambda: env.step(actions), lambda: env.call("belief"), lambda: env.get_attr("world")):
        with pytest.raises(gymnasium.error.ClosedEnvironmentError):
            call()
    env.close()

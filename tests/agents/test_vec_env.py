import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import CheckpointCallback
from stable_baselines3.common.vec_env import VecNormalize

from agents.config import EnvironmentConfig
from agents.vec_env import GymnasiumVecEnv
from agents.vector import make_vector

QUICK = EnvironmentConfig(world="rooms", world_size=(6.0, 6.0), control_hz=5.0, time_limit=3.0)


def make_lanes(mode=AutoresetMode.SAME_STEP):
    return gymnasium.make_vec(QUICK.id, 3, split="train", autoreset_mode=mode, **QUICK.arguments)


def test_lanes_give_what_single_environments_give():
    singles = QUICK.model_copy(update={"vectorization": "sync"})
    ours, theirs = (GymnasiumVecEnv(make_vector(config, "train", 3)) for config in (QUICK, singles))
    for env in (ours, theirs):
        env.seed(11)
    first, expected = ours.reset(), theirs.reset()
    assert all((first[key] == expected[key]).all() for key in expected)
    ended = 0
    for action in np.random.default_rng(0).uniform(-1, 1, (32, 3, 2)).astype(np.float32):
        (seen, rewards, dones, infos), (expected, wanted, ends, their_infos) = ours.step(action), theirs.step(action)
        assert all((seen[key] == expected[key]).all() for key in expected)
        np.testing.assert_array_equal(rewards, wanted)
        np.testing.assert_array_equal(dones, ends)
        for info, other in zip(infos, their_infos, strict=True):
            assert set(info) == set(other)
            if info:
                ended += 1
                last, other_last = info.pop("terminal_observation"), other.pop("terminal_observation")
                assert all((last[key] == other_last[key]).all() for key in other_last)
                assert info == {**other, "episode": pytest.approx(other["episode"])}
    assert ended == 6
    ours.close()


def test_other_autoresets_are_refused():
    env = make_lanes(AutoresetMode.NEXT_STEP)
    with pytest.raises(ValueError, match="SAME_STEP"):
        GymnasiumVecEnv(env)
    env.close()


def test_normalisation_callbacks_and_resuming_work_as_in_stable_baselines3(tmp_path):
    """With the library's own PPO, policy, `VecNormalize` and `CheckpointCallback`."""
    env = VecNormalize(GymnasiumVecEnv(make_lanes()), norm_obs_keys=["motion"])
    # A checkpoint every eight steps of the three lanes.
    keep = CheckpointCallback(8, str(tmp_path), save_vecnormalize=True)
    model = PPO("MultiInputPolicy", env, n_steps=32, batch_size=48, n_epochs=1, seed=3)
    model.learn(192, keep)
    assert env.ret_rms.count > 192
    assert len(model.ep_info_buffer) == 12  # episodes of 15 steps: four in each lane
    env.close()

    lanes = VecNormalize.load(str(tmp_path / "rl_model_vecnormalize_96_steps.pkl"), GymnasiumVecEnv(make_lanes()))
    resumed = PPO.load(tmp_path / "rl_model_96_steps.zip", lanes)
    assert resumed.num_timesteps == 96
    resumed.learn(96, reset_num_timesteps=False)
    assert resumed.num_timesteps == 192
    lanes.close()

"""The guide to other libraries, section Tianshou 2."""

from functools import partial

import gymnasium
import numpy as np
import pytest

import lidarnaut  # noqa: F401


@pytest.mark.parametrize("id", ["Explore", "ReachGoal"])
def test_the_buffer_of_tianshou_stores_fixed_info_and_finds_no_missing_values(id):
    pytest.importorskip("tianshou", reason="tianshou is not installed", exc_type=ImportError)
    from tianshou.algorithm.algorithm_base import Policy
    from tianshou.data import Batch, Collector, VectorReplayBuffer
    from tianshou.env import DummyVectorEnv

    arguments = {"observations": ("motion",), "time_limit": 0.5, "physics": "kinematic"}
    make = partial(gymnasium.make, f"lidarnaut/{id}-v0", fixed_info=True, **arguments)

    class Standing(Policy):
        def forward(self, batch, state=None, **_):
            return Batch(act=np.zeros((len(batch.obs.motion), 2), dtype=np.float32))

    env = make()
    policy = Standing(action_space=env.action_space, observation_space=env.observation_space)
    buffer = VectorReplayBuffer(10_000, buffer_num=4)
    collector = Collector(policy, DummyVectorEnv([make] * 4), buffer, raise_on_nan_in_buffer=True)
    collector.reset()
    assert collector.collect(n_step=48).n_collected_episodes == 8
    ended = buffer.truncated.astype(bool)[: len(buffer)]
    assert set(buffer.info.end_reason[: len(buffer)][ended]) <= {"time_limit", ""}

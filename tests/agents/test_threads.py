from contextlib import closing

import gymnasium
import numpy as np
import pytest
import torch

import lidarnaut


@pytest.fixture
def two_threads():
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


def test_learned_policies_use_one_thread_and_leave_the_number_of_the_process(two_threads, monkeypatch):
    policy = lidarnaut.make_policy("pretrained/reach")
    assert torch.get_num_threads() == 2
    used = []

    def act(batch, starts):
        used.append(torch.get_num_threads())
        return np.zeros((1, 2), np.float32)

    monkeypatch.setattr(policy, "_actor", act)
    with closing(gymnasium.make(policy.id, physics="kinematic", **{**policy.arguments, "time_limit": 0.5})) as env:
        lidarnaut.run_episode(env, policy, 0)
        monkeypatch.setattr(policy, "_actor", lambda batch, starts: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            lidarnaut.run_episode(env, policy, 0)
    assert set(used) == {1}
    assert torch.get_num_threads() == 2

import json
import shutil

import numpy as np
import pytest
import torch
from stable_baselines3 import PPO

from lidarnaut.agents import learning
from lidarnaut.agents.algorithms import prepare
from lidarnaut.agents.checkpoint import load_checkpoint
from lidarnaut.agents.config import parse_config
from lidarnaut.agents.explorer import LearnedPolicy
from lidarnaut.agents.replay import FOLDER
from lidarnaut.agents.run_folder import CheckpointError, find_checkpoint, list_checkpoints
from lidarnaut.agents.training import train
from lidarnaut.agents.vec_env import make_env
from lidarnaut.envs.core import lidar_env_of
from tests.agents.tiny import CASES, WITH_BUFFER, tiny

SLOW = ("TQC", "CrossQ", "QRDQN")
"""Algorithms whose trainings run the code of SAC's and DQN's; `test_export.py` trains them, too."""


@pytest.mark.parametrize(
    ("algorithm", "id"),
    [pytest.param(*case, marks=[pytest.mark.slow] * (case[0] in SLOW)) for case in CASES],
)
def test_two_updates_go_on_alike_from_a_checkpoint_and_act(algorithm, id, trained, tmp_path):
    config, source = trained(algorithm, id)
    run, copied = (shutil.copytree(source, tmp_path / name) for name in ("run", "copied"))
    more = config.model_copy(update={"total_steps": 32})
    for one in (run, copied):
        train(more, resume=one, progress=False)
    first, second = (load_checkpoint(find_checkpoint(one), trust="tests") for one in (run, copied))
    assert first.record.steps == 32
    for one, other in ((first.policy, second.policy), (first.training, second.training)):
        torch.testing.assert_close(one, other, atol=0.0, rtol=0.0)
    before = load_checkpoint(list_checkpoints(run)[0], trust="tests").policy
    assert any(not torch.equal(before[key], first.policy[key]) for key in before)
    assert bool(first.record.replay) == (algorithm in WITH_BUFFER)
    rows = first.record.evaluations
    has_prior = id == "ExploreFrontiers" and algorithm in ("PPO", "A2C")  # then the untrained policy is evaluated, too
    assert [row["policy"] for row in rows] == ["learned"] * (2 + has_prior)
    assert all(np.isfinite(row["progress"]) for row in rows)

    env = make_env(config.environment, "test")
    policy, inner = LearnedPolicy.load(run, trust="tests"), lidar_env_of(env)
    assert policy.control_hz == pytest.approx(1.0 / inner.control_period)
    assert policy.level == ("decision" if "Frontiers" in id else "twist")
    assert (policy.id, policy.arguments) == (config.environment.id, config.environment.arguments)
    observation, _ = env.reset(seed=0)
    actions = []
    for _ in range(2):
        policy.reset(inner.robot_params, inner.control_period, np.random.default_rng(0))
        actions.append([policy(observation) for _ in range(2)])
    assert env.action_space.contains(actions[0][0])
    np.testing.assert_array_equal(*actions)
    # A recurrent policy has memory until the next episode.
    assert np.array_equal(*actions[0]) == (algorithm != "RecurrentPPO")
    env.close()


def test_a_replay_buffer_comes_back_as_it_was_and_leaves_nothing_behind(tmp_path, monkeypatch):
    """The buffer has room for six steps of two environments; sixteen are taken, and it is written every four."""
    models, build = [], learning.build_model
    monkeypatch.setattr(learning, "build_model", lambda *args: models.append(build(*args)) or models[-1])
    config = tiny("SAC", "Explore", total_steps=32)
    run = train(config, run=tmp_path / "run", progress=False)
    names = {path.name for path in (run / FOLDER).iterdir()}
    checkpoints = [json.loads((folder / "checkpoint.json").read_text()) for folder in list_checkpoints(run)]
    assert [record["steps"] for record in checkpoints][-2:] == [24, 32]
    assert names == {name for record in checkpoints for name in record["replay"]}
    assert sorted(names)[-1] == "000000000012-000000000016.safetensors"
    assert not list(run.rglob("*.pkl"))
    train(config, resume=run, progress=False)
    whole, again = (model.replay_buffer for model in models)
    assert again.full
    assert again.buffer_size == 6
    # The ring buffer was at row 16 of 6: the oldest row is in slot 4, and has to be in slot 0 now.
    order = (np.arange(6) + 16) % 6
    for name in ("actions", "rewards", "dones", "timeouts"):
        np.testing.assert_array_equal(getattr(whole, name)[order], getattr(again, name))
    for name in whole.observations:
        np.testing.assert_array_equal(whole.observations[name][order], again.observations[name])
        np.testing.assert_array_equal(whole.next_observations[name][order], again.next_observations[name])

    larger = config.model_copy(update={"hyperparameters": {**config.hyperparameters, "buffer_size": 40}})
    train(larger, resume=run, progress=False)
    assert (models[-1].replay_buffer.pos, models[-1].replay_buffer.full) == (8, False)  # all rows of the files
    (run / FOLDER / sorted(names)[-1]).write_bytes(b"damaged")
    with pytest.raises(CheckpointError, match=r"000000000012-000000000016.* is damaged: its checksum differs"):
        train(config, resume=run, progress=False)


def test_an_interrupt_saves_what_an_algorithm_with_a_buffer_has_learned(tiny_data, tmp_path):
    data = {**tiny_data, "algorithm": "SAC", "environment": tiny_data["environment"] | {"world": "interrupted_30"}}
    data["hyperparameters"] = {"learning_starts": 8, "batch_size": 4, "train_freq": 2, "buffer_size": 100}
    data["checkpoints"] = {"every": 1000}
    run = tmp_path / "run"
    with pytest.raises(KeyboardInterrupt, match=f"at step 116 \\(saved\\); resume with --resume {run}"):
        train(parse_config(data, "mem"), run=run, progress=False)
    record = load_checkpoint(find_checkpoint(run), trust="tests").record
    assert record.replay.keys() == {"000000000004-000000000029.safetensors"}


def test_a_missing_gpu_is_reported(tiny_config, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(ValueError, match="torch finds no GPU; allowed values are 'cpu' and 'auto'"):
        prepare(tiny_config.model_copy(update={"device": "cuda"}), PPO, env=None)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_a_training_on_a_gpu_goes_on_anywhere(tiny_data, tmp_path):
    config = parse_config({**tiny_data, "total_steps": 256, "device": "cuda"}, "mem")
    run = train(config, run=tmp_path / "run", progress=False)
    more = config.model_copy(update={"total_steps": 512, "device": "cpu"})
    train(more, resume=run, progress=False)
    assert load_checkpoint(find_checkpoint(run), trust="tests").record.steps == 512

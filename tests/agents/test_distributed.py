"""Trainings in several processes."""

import copy
import ctypes
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.type_aliases import RolloutBufferSamples

from lidarnaut.agents import algorithms, distributed
from lidarnaut.agents.algorithms import find_algorithm, num_processes
from lidarnaut.agents.checkpoint import load_checkpoint
from lidarnaut.agents.config import TrainingConfig
from lidarnaut.agents.distributed import Limit, Local, Share
from lidarnaut.agents.run_folder import find_checkpoint
from lidarnaut.agents.training import train
from lidarnaut.agents.vec_env import make_vec_env
from lidarnaut.envs.files import dump_record, parse_record
from tests.agents.fake_env import ID
from tests.agents.tiny import tiny, untrained
from train import main

ROOT = Path(__file__).parents[2]


def make_groups(size):
    """Return groups of one process each, which are threads here."""
    context = multiprocessing.get_context("spawn")
    shared = context.RawArray(ctypes.c_float, 2 * size * distributed.CHUNK)
    posts = [[context.Semaphore(0) for _ in range(size)] for _ in range(size)]
    return [Local(rank, size, shared, posts) for rank in range(size)]


def in_threads(function, *columns):
    with ThreadPoolExecutor(len(columns[0])) as pool:
        return list(pool.map(function, *columns))


@pytest.mark.parametrize("size", [2, 3, 5])
def test_all_processes_get_the_same_means_of_any_count_of_numbers_again_and_again(size, monkeypatch):
    monkeypatch.setattr(distributed, "CHUNK", 16)
    rng = np.random.default_rng(0)
    numbers = [[rng.normal(size=count).astype(np.float32) for count in (1, 16, 17, 100, 3)] * 20 for _ in range(size)]

    def average(group, own):
        found = [torch.from_numpy(one.copy()) for one in own]
        for one in found:
            if rng.random() < 0.1:
                time.sleep(0.002)
            group.average(one)
        return found

    first, *others = in_threads(average, make_groups(size), numbers)
    for k, mean in enumerate(first):
        np.testing.assert_allclose(mean, np.mean([own[k] for own in numbers], axis=0), rtol=1e-5, atol=1e-6)
        assert all(torch.equal(mean, other[k]) for other in others)


@pytest.mark.parametrize(("algorithm", "id"), [("PPO", "Explore"), ("A2C", "Navigate"), ("PPO", "ExploreFrontiers")])
def test_processes_with_parts_of_a_batch_have_the_gradient_of_the_whole(algorithm, id):
    with closing(make_vec_env(config := tiny(algorithm, id))) as env:
        whole = untrained(config, env)
        env.seed(0)
        seen = {name: torch.from_numpy(np.repeat(part, 4, axis=0)) for name, part in env.reset().items()}
        with torch.no_grad():
            actions = whole.policy(seen)[0]
        models = []
        for _ in range(2):
            model = SimpleNamespace(policy=copy.deepcopy(whole.policy), seed=0, num_timesteps=0, env=env)
            models.append(model)

        def differentiate(model, part, group=None):
            if group:
                Share(model, group)
            rows = {name: one[part] for name, one in seen.items()}
            values, log_probs, entropy = model.policy.evaluate_actions(rows, actions[part])
            (values.sum(1) + 0.5 * log_probs + 0.1 * entropy).mean().backward()
            return [weight.grad for weight in model.policy.parameters()]

        expected = differentiate(whole, slice(None))
        halves = in_threads(differentiate, models, (slice(0, 4), slice(4, 8)), make_groups(2))
    assert any(gradient is not None and gradient.abs().max() > 0.0 for gradient in expected)
    for one, first, second in zip(expected, *halves, strict=True):
        assert (one is None) == (first is None)
        if one is not None:
            torch.testing.assert_close(first, one, rtol=1e-4, atol=1e-6)
            assert torch.equal(first, second)


def test_advantages_are_normalized_and_divergences_limited_over_all_processes():
    rng = np.random.default_rng(1)
    advantages = torch.from_numpy(rng.normal(2.0, 3.0, (2, 50)).astype(np.float32))
    expected = (advantages - advantages.mean()) / (advantages.std() + 1e-8)

    def normalize(group, own):
        batch = RolloutBufferSamples(*[own] * 6)
        (found,) = distributed._normalized(lambda batch_size: [batch], group, 50)
        return found.advantages, [np.float32(value) > 1.5 * Limit(0.1, group) for value in (0.05, 0.149, 0.151)]

    (first, is_above), (second, other) = in_threads(normalize, make_groups(2), advantages)
    torch.testing.assert_close(torch.stack([first, second]), expected, rtol=1e-4, atol=1e-5)
    assert is_above == other == [False, False, True]

    def compare(group, value):
        return np.array(value, dtype=np.float32) > 1.5 * Limit(0.1, group)

    assert in_threads(compare, make_groups(2), (0.0, 0.2)) == [False, False]
    assert in_threads(compare, make_groups(2), (0.0, 0.4)) == [True, True]


@pytest.mark.parametrize(
    ("changes", "algorithm", "why"),
    [
        ({"num_envs": 3}, "PPO", "num_envs is 3, which 2 processes cannot share equally"),
        ({"hyperparameters": {"batch_size": 7}}, "PPO", "hyperparameters.batch_size is 7, which 2 processes"),
        ({}, "SAC", "2 processes train together, but algorithm SAC allows only one"),
        ({}, "TRPO", "algorithm TRPO allows only one"),
        ({"device": "cuda"}, "PPO", "device 'cuda' allows only one"),
    ],
)
def test_trainings_that_cannot_be_shared_are_refused(changes, algorithm, why):
    config = tiny(algorithm, "Explore", processes=2, **changes)
    with pytest.raises(ValueError, match=why):
        num_processes(config, find_algorithm(algorithm))


def test_default_is_one_process_per_core_that_divides_the_work(monkeypatch):
    monkeypatch.setattr(algorithms, "num_cores", lambda: 4)
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    count = lambda num_envs=12, **changes: num_processes(tiny("PPO", "Explore", num_envs=num_envs, **changes), PPO)  # noqa: E731
    assert [count(), count(6), count(7), count(hyperparameters={"batch_size": 9})] == [4, 2, 1, 3]
    assert count(environment={"robots": ["turtlebot3_burger"] * 5}) == 2
    assert num_processes(tiny("SAC", "Explore"), find_algorithm("SAC")) == 1
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    assert count() == 1
    assert count(processes=4) == 4


def shared(data, **changes):
    """Return a training in two processes."""
    return parse_record({**data, "processes": 2, "torch_threads": 1, **changes}, "tiny", TrainingConfig)


def weights_of(run, which="last"):
    return load_checkpoint(find_checkpoint(run, which), trust="tests").policy


def test_torchrun_gives_the_same_weights_and_a_run_resumes_with_another_number(tiny_data, tmp_path, caplog):
    config = shared(tiny_data, hyperparameters=tiny_data["hyperparameters"] | {"target_kl": 0.01})
    first = train(config, run=tmp_path / "first", progress=False)
    (tmp_path / "tiny.yaml").write_text(dump_record(config))
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    command += [str(ROOT / "train.py"), "--config", "tiny.yaml"]
    own = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=tmp_path, env=own, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("results are in") == 1
    (run,) = (tmp_path / "runs").iterdir()
    one, other = weights_of(first), weights_of(run)
    assert all(torch.equal(one[name], other[name]) for name in one)
    assert main(["--resume", str(run), "--trust", ID, "--total-steps", "1024", "--processes", "1"]) == 0
    assert "1 processes train; before, 2 did: weights will differ" in caplog.text
    assert find_checkpoint(run).name == "step_000001024"


@pytest.mark.parametrize("changes", [{"seeds": [0, 1]}, {"algorithm": "evolution"}, {"algorithm": "completion"}])
def test_torchrun_starts_no_sweeps_and_other_kinds(changes, tiny_data, monkeypatch):
    monkeypatch.setenv("TORCHELASTIC_RUN_ID", "x")
    monkeypatch.setenv("RANK", "0")
    with pytest.raises(ValueError, match="torchrun starts single trainings by reinforcement learning"):
        train({**tiny_data, **changes})


@pytest.mark.parametrize("how", ["killed", "failed"])
def test_a_process_that_ends_ends_the_training_with_its_reason_and_a_checkpoint(
    how, tiny_data, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    config = shared(tiny_data, environment=tiny_data["environment"] | {"world": f"{how}_100"})
    (tmp_path / "tiny.yaml").write_text(dump_record(config))
    assert main(["--config", "tiny.yaml"]) == 2
    said = capsys.readouterr().err.strip().splitlines()[-1]
    reason = " has ended with exit code -9" if how == "killed" else ": RuntimeError: no further world"
    assert f"process 1 of the training{reason}; the training ended at step " in said
    assert "--resume" in said
    assert not multiprocessing.active_children()
    (run,) = Path("runs").iterdir()
    assert main(["--resume", str(run), "--trust", ID, "--environment.world", "rooms"]) == 0


def test_ctrl_c_saves_and_ends_all_processes(tiny_data, tmp_path):
    config = shared(tiny_data, total_steps=10**7)
    (tmp_path / "tiny.yaml").write_text(dump_record(config))
    command, own = [sys.executable, str(ROOT / "train.py"), "--config", "tiny.yaml"], {"PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(
        command, cwd=tmp_path, env=os.environ | own, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    lines = []
    reader = threading.Thread(target=lambda: lines.extend(process.stderr))
    reader.start()
    checkpoints = partial(tmp_path.glob, "runs/*/checkpoints/step_0*[1-9]*")
    end = time.monotonic() + 120
    while not any(checkpoints()) and time.monotonic() < end:
        time.sleep(0.1)
    os.killpg(process.pid, signal.SIGINT)
    status = process.wait(30)
    reader.join(10)
    assert status == 130, lines[-2:]
    assert "stopped at step" in lines[-1]
    assert "--resume" in lines[-1]
    assert not any("Traceback" in line for line in lines)

import errno
import hashlib
import json
import os
import resource
import shutil

import numpy as np
import pytest
import safetensors.torch
import torch

from lidarnaut.agents.algorithms import build_policy
from lidarnaut.agents.checkpoint import load_checkpoint, save_checkpoint
from lidarnaut.agents.run_folder import CheckpointError, find_checkpoint, list_checkpoints
from lidarnaut.agents.state import capture, restore
from lidarnaut.agents.vec_env import GymnasiumVecEnv, make_vector
from lidarnaut.envs.files import writing as files
from tests.agents.tiny import untrained


@pytest.fixture
def fresh_model(tiny_config):
    def make(**changes):
        config = tiny_config.model_copy(update=changes)
        return untrained(config, GymnasiumVecEnv(make_vector(config.environment, "train", 4)))

    return make


@pytest.fixture
def run(tiny_run, tmp_path):
    return shutil.copytree(tiny_run, tmp_path / "run")


def draw():
    return np.random.standard_normal(3), np.random.permutation(9), torch.randn(3).numpy()  # noqa: NPY002


def assert_same(a, b):
    torch.testing.assert_close(dict(a), dict(b), atol=0.0, rtol=0.0)


def test_a_checkpoint_comes_back_bit_for_bit(fresh_model, tiny_config, tmp_path):
    model = fresh_model()
    model.learn(256)
    np.random.standard_normal()  # noqa: NPY002 (keeps the second number of a pair: hidden state)
    row = {"policy": "learned", "steps": 256, "progress": 0.1, "success": 0.5}
    row |= {"spl": 0.1, "spl_q25": 0.1, "scores": "0.1"}
    saved = capture(model, tiny_config, [row], 5.0)
    folder = save_checkpoint(saved, tmp_path, keep=2)
    drawn = draw()
    other = fresh_model(seed=99)
    loaded = load_checkpoint(folder, trust="tests")
    restore(other, loaded, folder)
    np.testing.assert_equal(draw(), drawn)
    assert_same(other.policy.state_dict(), model.policy.state_dict())
    assert (other.num_timesteps, other._n_updates) == (256, model._n_updates)
    assert loaded.record.evaluations == saved.record.evaluations

    # The optimizer's state affects the next gradient step.
    observation = {key: torch.as_tensor(value) for key, value in model.env.reset().items()}
    for each in (model, other):
        each.policy.optimizer.param_groups[0]["lr"] = 1e-3  # as the schedule does at each update
        each.policy.optimizer.zero_grad()
        each.policy.predict_values(observation).square().sum().backward()
        each.policy.optimizer.step()
    assert_same(other.policy.state_dict(), model.policy.state_dict())
    assert_same(build_policy(loaded, folder).state_dict(), saved.policy)


def take(folder, model):
    checkpoint = load_checkpoint(folder, trust="tests")
    build_policy(checkpoint, folder)
    restore(model, checkpoint, folder)


def change_tensors(folder, file, change):
    """Change the tensors of a file and update its checksum."""
    tensors = safetensors.torch.load_file(folder / file)
    change(tensors)
    content = safetensors.torch.save(tensors)
    (folder / file).write_bytes(content)
    record = json.loads((folder / RECORD).read_text())
    record["sha256"][file] = hashlib.sha256(content).hexdigest()
    (folder / RECORD).write_text(json.dumps(record))


def replace_text(folder, file, change):
    text = (folder / file).read_text()
    assert change[0] in text
    (folder / file).write_text(text.replace(*change, 1))


def write(folder, file, content):
    (folder / file).unlink()
    if content is not None:
        (folder / file).write_bytes(content)


POLICY, TRAINING, RECORD = "policy.safetensors", "training.safetensors", "checkpoint.json"


@pytest.mark.parametrize(
    ("damage", "file", "change", "message"),
    [
        (write, TRAINING, b"x", "training.safetensors was altered or truncated"),
        (write, POLICY, None, "No such file.*policy.safetensors"),
        (write, RECORD, None, "No such file.*checkpoint.json"),
        (write, RECORD, b"\xff\x00", "checkpoint.json"),
        (write, RECORD, b"[" * 100_000, "checkpoint.json: Invalid JSON: recursion limit"),
        (replace_text, RECORD, ('"updates"', '"updatse"'), "checkpoint.json: .*'updates' is missing"),
        (replace_text, RECORD, ('"shape": [', '"shape": [90000, '), r"observation\..*more than 10,000,000 elements"),
        (replace_text, RECORD, ('"high": 255.0', '"high": 1e30'), r"observation\..*1e\+30 lie outside of uint8"),
        (replace_text, RECORD, ('"MT19937"', '"MT19938"'), "checkpoint.json: numpy_random.*MT19937"),
        (replace_text, RECORD, ('"hidden": 64', '"hidden": 9999'), "network: hidden: .*less than or equal to 8192"),
        (replace_text, RECORD, ('"policy"', '"polcy"'), "damaged row: KeyError: 'policy'"),
        (replace_text, RECORD, ("_q25", "_q26"), r"damaged row: KeyError: '\*_q25'"),
        (replace_text, RECORD, ('"scores": "', '"scores": "x '), "damaged row: .*'x'"),
        (replace_text, RECORD, ('"replay": {', '"replay": {"../../a-1.safetensors": ""'), "replay.*match pattern"),
        (change_tensors, POLICY, lambda t: t.pop("log_std"), "policy.safetensors lacks the tensor 'log_std'"),
        (change_tensors, POLICY, lambda t: t["log_std"].fill_(torch.nan), "'log_std' contains non-finite numbers"),
        (change_tensors, TRAINING, lambda t: t.update(x=torch.zeros(1)), "has an unknown tensor 'x'"),
        (
            change_tensors, POLICY, lambda t: t.update(log_std=torch.zeros(3)),
            r"'log_std' is float32 \(3,\), the network of its configuration needs float32 \(2,\)",
        ),
    ],
)  # fmt: skip
def test_a_damaged_checkpoint_is_named_with_the_remedy(damage, file, change, message, run, fresh_model):
    *_, older, newest = list_checkpoints(run)
    damage(newest, file, change)
    model = fresh_model()
    with pytest.raises(CheckpointError, match=message) as caught:
        take(newest, model)
    assert f"checkpoint {newest} is damaged" in str(caught.value)
    assert f"use the previous checkpoint, {older}" in str(caught.value)
    take(older, model)


def test_a_full_disk_costs_nothing_but_the_new_checkpoint(run, monkeypatch):
    def contents():
        return {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}

    before = contents()
    checkpoint = load_checkpoint(find_checkpoint(run), trust="tests")
    checkpoint.record.steps += 128

    def full(descriptor):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(files.os, "fsync", full)
        with pytest.raises(CheckpointError, match=r"step_000000896 could not be written: no space is left") as caught:
            save_checkpoint(checkpoint, run, keep=2)
    assert f"--resume {run}" in str(caught.value)

    # The limit on the file size stops a write half way.
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))
    try:
        with pytest.raises(CheckpointError, match="could not be written: File too large"):
            save_checkpoint(checkpoint, run, keep=2)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert contents() == before
    assert not list(run.rglob("*.tmp"))
    save_checkpoint(checkpoint, run, keep=2)
    assert [path.name for path in list_checkpoints(run)][-2:] == ["step_000000768", "step_000000896"]


def test_folders_without_a_checkpoint_are_reported(tmp_path):
    with pytest.raises(CheckpointError, match=r"nowhere is not a folder; a run folder contains checkpoints/step_"):
        find_checkpoint(tmp_path / "nowhere")
    with pytest.raises(CheckpointError, match="is neither a run folder nor a checkpoint folder"):
        find_checkpoint(tmp_path)

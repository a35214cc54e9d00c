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

from agents.algorithms import build_model, build_policy
from agents.checkpoint import load_checkpoint, save_checkpoint
from agents.run_folder import CheckpointError, find_checkpoint, list_checkpoints
from agents.state import capture, restore
from agents.vec_env import GymnasiumVecEnv, make_vector
from envs.files import writing as files


@pytest.fixture
def fresh_model(tiny_config):
    def make(**changes):
        config = tiny_config.model_copy(update=changes)
        return build_model(config, GymnasiumVecEnv(make_vector(config.environment, "train", 4)))

    return make


@pytest.fixture
def run(tiny_run, tmp_path):
    """A copy of a finished run, to be damaged."""
    return shutil.copytree(tiny_run, tmp_path / "run")


def equal_tensors(a, b):
    return a.keys() == b.keys() and all(torch.equal(a[key], b[key]) for key in a)


def test_a_checkpoint_comes_back_bit_for_bit(fresh_model, tiny_config, tmp_path):
    model = fresh_model()
    model.learn(256)
    np.random.standard_normal()  # noqa: NPY002  (leaves half a pair behind: the hidden part of the state)
    saved = capture(model, tiny_config, [{"policy": "learned", "steps": 256, "progress": 0.1}], 5.0)
    folder = save_checkpoint(saved, tmp_path, keep=2)
    drawn = np.random.standard_normal(3), np.random.permutation(9), torch.randn(3)  # noqa: NPY002

    other = fresh_model(seed=99)
    loaded = load_checkpoint(folder)
    restore(other, loaded, folder)
    again = np.random.standard_normal(3), np.random.permutation(9), torch.randn(3)  # noqa: NPY002
    assert all(np.array_equal(a, b) for a, b in zip(drawn, again, strict=True))
    assert equal_tensors(other.policy.state_dict(), model.policy.state_dict())
    assert (other.num_timesteps, other._n_updates) == (256, model._n_updates)
    assert loaded.record.evaluations == saved.record.evaluations

    # The optimizer's state shows in what the next gradient step does.
    observation = {key: torch.as_tensor(value) for key, value in model.env.reset().items()}
    for each in (model, other):
        each.policy.optimizer.param_groups[0]["lr"] = 1e-3  # what the schedule does at each update
        each.policy.optimizer.zero_grad()
        each.policy.predict_values(observation).square().sum().backward()
        each.policy.optimizer.step()
    assert equal_tensors(other.policy.state_dict(), model.policy.state_dict())
    assert equal_tensors(build_policy(loaded, folder).state_dict(), saved.policy)


def tensors(file, change):
    """Change the tensors of a file and its checksum: what an honest tool could have written."""

    def damage(folder):
        tensors = safetensors.torch.load_file(folder / file)
        change(tensors)
        content = safetensors.torch.save(tensors)
        (folder / file).write_bytes(content)
        record = json.loads((folder / "checkpoint.json").read_text())
        record["sha256"][file] = hashlib.sha256(content).hexdigest()
        (folder / "checkpoint.json").write_text(json.dumps(record))

    return damage


def text(old, new):
    """Change the record."""

    def damage(folder):
        path = folder / "checkpoint.json"
        assert old in path.read_text()
        path.write_text(path.read_text().replace(old, new, 1))

    return damage


def content(file, change):
    """Change the bytes of a file; None removes it."""
    return lambda folder: (folder / file).unlink() if change is None else (folder / file).write_bytes(change)


DAMAGES = [
    (content("training.safetensors", b"x"), "training.safetensors is not what was written"),
    (content("policy.safetensors", None), "No such file.*policy.safetensors"),
    (content("checkpoint.json", None), "No such file.*checkpoint.json"),
    (content("checkpoint.json", b"\xff\x00"), "checkpoint.json"),
    (content("checkpoint.json", b"[" * 100_000), "checkpoint.json: Invalid JSON: recursion limit"),
    (text('"updates"', '"updatse"'), "checkpoint.json: .*'updates' is missing"),
    (text('"shape": [', '"shape": [90000, '), r"observation\..*more than 10,000,000 elements"),
    (text('"high": 255.0', '"high": 1e30'), r"checkpoint.json: observation\..*1e\+30 lie outside of uint8"),
    (text('"MT19937"', '"MT19938"'), "checkpoint.json: numpy_random.*MT19937"),
    (tensors("policy.safetensors", lambda t: t.pop("log_std")), "policy.safetensors lacks the tensor 'log_std'"),
    (
        tensors("policy.safetensors", lambda t: t["log_std"].fill_(torch.nan)),
        "'log_std' holds numbers that are not",
    ),
    (tensors("training.safetensors", lambda t: t.update(x=torch.zeros(1))), "has an unknown tensor 'x'"),
    (
        tensors("policy.safetensors", lambda t: t.update(log_std=torch.zeros(3))),
        r"'log_std' is float32 \(3,\), the network of its configuration needs float32 \(2,\)",
    ),
]


@pytest.mark.parametrize(("damage", "message"), DAMAGES)
def test_a_damaged_checkpoint_is_named_with_the_remedy(damage, message, run, fresh_model):
    older, newest = list_checkpoints(run)
    damage(newest)
    model = fresh_model()
    with pytest.raises(CheckpointError, match=message) as caught:
        restore(model, load_checkpoint(newest), newest)
    assert f"checkpoint {newest} is damaged" in str(caught.value)
    assert f"use the one before it, {older}" in str(caught.value)
    restore(model, load_checkpoint(older), older)


def test_a_network_of_an_absurd_size_is_refused(run):
    newest = find_checkpoint(run)
    text('"hidden": 64', '"hidden": 1000000000000')(newest)
    with pytest.raises(CheckpointError, match=r"is damaged: .*network: hidden: .*less than or equal to 8192"):
        build_policy(load_checkpoint(newest), newest)


def test_a_full_disk_costs_nothing_but_the_new_checkpoint(run, monkeypatch):
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    checkpoint = load_checkpoint(find_checkpoint(run))
    checkpoint.record.steps += 128

    def full(descriptor):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(files.os, "fsync", full)
        with pytest.raises(CheckpointError, match=r"step_000000896 could not be written: no space is left") as caught:
            save_checkpoint(checkpoint, run, keep=2)
    assert f"--resume {run}" in str(caught.value)

    # A write that really stops half way, at the limit on the size of a file.
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))
    try:
        with pytest.raises(CheckpointError, match="could not be written: File too large"):
            save_checkpoint(checkpoint, run, keep=2)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert {path: path.read_bytes() for path in run.rglob("*") if path.is_file()} == before
    assert not list(run.rglob("*.tmp"))
    save_checkpoint(checkpoint, run, keep=2)
    assert [path.name for path in list_checkpoints(run)] == ["step_000000768", "step_000000896"]


def test_folders_without_a_checkpoint_are_reported(tmp_path):
    with pytest.raises(CheckpointError, match=r"nowhere is no folder; a run folder has checkpoints/step_<number>/"):
        find_checkpoint(tmp_path / "nowhere")
    with pytest.raises(CheckpointError, match="is neither a run folder nor a checkpoint folder"):
        find_checkpoint(tmp_path)

import json
import shutil

import numpy as np
import pytest
import safetensors.torch
import torch

from lidarnaut import make_policy, train_command
from lidarnaut.agents.completion import training
from lidarnaut.agents.completion.completion import Completion
from lidarnaut.agents.completion.network import CompletionNetwork
from lidarnaut.agents.completion.snapshots import (
    FLOOR,
    Snapshot,
    collect,
    floor_distance,
    load_snapshots,
    save_snapshots,
)
from lidarnaut.agents.completion.training import train_completion
from lidarnaut.agents.config import CompletionConfig
from lidarnaut.agents.run_folder import CheckpointError, list_checkpoints

TINY = {"algorithm": "completion", "experiment": "tiny", "episodes": 2, "validation_episodes": 1, "total_steps": 6}
TINY |= {"validate_every": 2, "batch_size": 2, "crop": 32, "num_workers": 1, "torch_threads": 1, "families": ("rooms",)}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return train_completion(CompletionConfig(**TINY), run=tmp_path_factory.mktemp("completion") / "run", progress=False)


def test_a_training_collects_fits_validates_and_leaves_a_policy(run):
    assert [int(path.name[5:]) for path in list_checkpoints(run)] == [0, 2, 4, 6]
    assert (run / "validation.csv").read_text().count("\n") == 4
    assert (run / "calibration.png").stat().st_size > 10_000
    record = json.loads((run / "policy" / "policy.json").read_text())
    assert record["steps"] == 6
    assert 0.0 < record["cross_entropy"] < 2.0
    explorer = make_policy(run)
    assert explorer.rule.params.reach == 2.0


def test_the_policy_has_the_running_mean_of_the_weights(run):
    states = [safetensors.torch.load_file(path / training.STATE_FILE) for path in list_checkpoints(run)]
    policy = safetensors.torch.load_file(run / "policy" / "weights.safetensors")
    for name, weights in policy.items():
        torch.testing.assert_close(weights, states[-1][f"mean.{name}"], rtol=0, atol=0)
    head = "head.weight"
    torch.testing.assert_close(states[0][f"mean.{head}"], states[0][f"network.{head}"], rtol=0, atol=0)
    assert not torch.equal(policy[head], states[-1][f"network.{head}"])
    # The first steps hardly hold back the mean.
    moved, followed = (states[-1][f"{key}.{head}"] - states[0][f"network.{head}"] for key in ("network", "mean"))
    assert 0.3 < float(followed.norm() / moved.norm()) < 1.0


@pytest.mark.parametrize("stop", ["snapshots", "steps"])
def test_a_stopped_training_goes_on_with_the_same_result(run, tmp_path, stop, monkeypatch):
    config = CompletionConfig(**TINY)
    shutil.copytree(run / "snapshots", tmp_path / "run" / "snapshots")  # collecting takes as long as all else

    def interrupt(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        if stop == "snapshots":
            patch.setattr(training, "load_snapshots", interrupt)
        else:
            step, real = iter(range(10)), training._draw_crop
            patch.setattr(training, "_draw_crop", lambda *of: real(*of) if next(step) < 7 else interrupt())
        with pytest.raises(
            KeyboardInterrupt, match=f"after step {0 if stop == 'snapshots' else 3}; resume with --resume"
        ):
            train_completion(config, run=tmp_path / "run", progress=False)
    for _ in range(2):  # a finished training stays as it is
        assert train_command.main(["--resume", str(tmp_path / "run")]) == 0
    weights = [path / "policy" / "weights.safetensors" for path in (run, tmp_path / "run")]
    assert weights[0].read_bytes() == weights[1].read_bytes()
    with pytest.raises(CheckpointError, match="total_steps"):
        train_completion(CompletionConfig(**TINY | {"total_steps": 8}), resume=tmp_path / "run", progress=False)


def test_what_cannot_be_is_refused(tmp_path, run):
    with pytest.raises(ValueError, match="one by one"):
        train_command.train("completion", {"seeds": [0, 1]})
    with pytest.raises(ValueError, match="unknown family"):
        CompletionConfig(**TINY | {"families": ("rooms", "moon")})
    with pytest.raises(ValueError, match="already holds a run"):
        train_completion(CompletionConfig(**TINY), run=run, progress=False)
    (tmp_path / "policy.json").write_text('{"kind": "completion"}')
    (tmp_path / "weights.safetensors").write_bytes(b"none")
    with pytest.raises(CheckpointError, match="no readable completion"):
        Completion.load(tmp_path)
    (tmp_path / "0.npz").write_bytes(b"none")
    with pytest.raises(ValueError, match="remove it"):
        load_snapshots(tmp_path / "0.npz")


def test_snapshots_are_the_same_for_the_same_seed_and_keep_their_bytes(tmp_path):
    first, again = (collect((0, 0, 5), 1, ("rooms",)) for _ in range(2))
    assert len(first) > 5
    save_snapshots(tmp_path / "some.npz", first)
    for one, other, read in zip(first, again, load_snapshots(tmp_path / "some.npz"), strict=True):
        assert (one == other).all()
        assert (one == read.cells).all()
    known = [np.count_nonzero(Snapshot(cells).codes) for cells in first]
    assert known[-1] > 2 * known[0]
    last = Snapshot(first[-1])
    assert last.floor[last.codes == 1].mean() > 0.95
    assert (first[-1] & FLOOR > 0).sum() >= 0.9 * last.floor.sum()


def test_the_network_learns_that_rooms_go_on():
    """Half-seen rooms of equal length: cells before the hidden far wall are floor, those behind it are not."""
    rng, snapshots = np.random.default_rng(0), []
    for _ in range(24):
        cells = np.zeros((64, 64), dtype=np.uint8)
        row, seen = int(rng.integers(8, 40)), int(rng.integers(12, 24))
        cells[row : row + 10, 8:32] |= FLOOR
        cells[row : row + 10, 8:seen] |= 1
        cells[row - 1, 7:seen] = cells[row + 10, 7:seen] = cells[row - 1 : row + 11, 7] = 2
        snapshots.append(Snapshot(cells))
    examples = [training._example(one, 3.0) for one in snapshots]
    torch.manual_seed(0)
    network = CompletionNetwork((8, 8, 8, 8))
    optimizer, shares = torch.optim.Adam(network.parameters(), 0.01), np.arange(1, 25) / 24.0
    for _ in range(60):
        crops = [training._draw_crop(examples, shares, 64, rng) for _ in range(8)]
        codes, floor, counts = (np.stack(parts) for parts in zip(*crops, strict=True))
        logits = network(training.channels_of(codes))[torch.from_numpy(counts)]
        target = torch.from_numpy(floor)[torch.from_numpy(counts)].float()
        loss = torch.nn.functional.binary_cross_entropy_with_logits(logits, target)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    completion = Completion(network)
    right = [(completion.probabilities(one.codes) > 0.5)[one.counts] == one.floor[one.counts] for one in examples]
    assert np.concatenate(right).mean() > 0.85


def test_distances_are_those_to_known_floor():
    codes = np.zeros((20, 20), dtype=np.uint8)
    assert np.isinf(floor_distance(codes)).all()
    codes[10, 10] = 1
    assert floor_distance(codes)[10, 13] == pytest.approx(0.6)

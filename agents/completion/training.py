"""Training of the completion network: explorations are collected, then their maps are completed.

The loss is the cross-entropy of unknown cells near known floor (see `CompletionConfig.horizon`), the optimizer AdamW
(Loshchilov and Hutter 2019, arXiv:1711.05101) with one cycle of learning rates. The policy has the running mean of the
weights (Polyak and Juditsky, "Acceleration of Stochastic Approximation by Averaging", 1992).
"""

import contextlib
import copy
import io
import itertools
import json
import math
import shutil
from collections import defaultdict
from concurrent.futures import Executor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import safetensors.torch
import torch
from safetensors import SafetensorError
from torch import Tensor
from torch.nn import functional
from torch.utils.tensorboard import SummaryWriter

from lidarnaut.agents.config import CompletionConfig
from lidarnaut.agents.learned import POLICY
from lidarnaut.agents.pools import make_pool
from lidarnaut.agents.resume import begin
from lidarnaut.agents.run_folder import CheckpointError, find_checkpoint, list_checkpoints, write_table
from lidarnaut.envs.files import own_folder, read_bytes, write_file, write_folder
from lidarnaut.envs.progress import Progress

from .completion import Completion
from .network import CompletionNetwork, channels_of
from .raster import STRIDE
from .snapshots import Snapshot, collect, floor_distance, load_snapshots, save_snapshots

SNAPSHOTS, STATE_FILE, TABLE, PICTURE = "snapshots", "training.safetensors", "validation.csv", "calibration.png"
TRAINING_STREAM, VALIDATION_STREAM, CROP_STREAM = 0, 1, 2
PART = 10
"""Number of explorations whose snapshots share a file."""
RISE = 0.1
"""Fraction of the training with a rising learning rate; then it falls to zero."""
WEIGHT_DECAY = 1e-3
DECAY, FIRST_STEPS = 0.999, 50
"""Factor per step of older weights in the running mean; after k steps at most k / (k + `FIRST_STEPS`)."""
LEAST_CELLS = 100
"""Minimum number of cells of a crop that count in the loss."""
BINS = 0.0, 1.0, 2.0, 4.0
"""Limits of distances from known floor in tables of validations [m]."""
LEVELS = np.linspace(0.0, 1.0, 11)
"""Limits of predicted probabilities whose true frequencies are listed."""


class Example(NamedTuple):
    """Snapshot with the cells that count in the loss."""

    codes: np.ndarray
    floor: np.ndarray
    counts: np.ndarray


def train_completion(
    config: CompletionConfig,
    *,
    run: Path | None = None,
    resume: Path | None = None,
    progress: bool = True,
) -> Path:
    """Train a network that completes maps; return the run folder, by default as that of a training.

    Arguments and errors are those of `lidarnaut.agents.frontiers.evolution.evolve`. Files of finished explorations and
    the last checkpoint are used by a resumed run, with the same result as without the interruption.
    """
    with contextlib.ExitStack() as held:
        pool = held.enter_context(make_pool(config.num_workers))
        resumed = None if resume is None else find_checkpoint(resume).parent.parent
        run = held.enter_context(begin(config, "completion", run, resumed))
        held.callback(torch.set_num_threads, torch.get_num_threads())
        if config.torch_threads is not None:
            torch.set_num_threads(config.torch_threads)
        training = _Training(config, run)
        try:
            collected = _collect(config, run, pool, TRAINING_STREAM, config.episodes, progress)
            kept = _collect(config, run, pool, VALIDATION_STREAM, config.validation_episodes, progress)
            with Progress(total=config.total_steps, initial=training.steps, disable=not progress, unit="step") as bar:
                training.fit(collected, kept, bar)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(f"after step {training.steps}; resume with --resume {run}") from None
    return run


def _collect(
    config: CompletionConfig, run: Path, pool: Executor, stream: int, episodes: int, progress: bool
) -> list[Snapshot]:
    folder = own_folder(run / SNAPSHOTS)
    paths = [folder / f"{stream}_{part:05d}.npz" for part in range(-(-episodes // PART))]
    jobs = {
        path: pool.submit(collect, (config.seed, stream, part), min(PART, episodes - PART * part), config.families)
        for part, path in enumerate(paths)
        if not path.exists()
    }
    done = len(paths) - len(jobs)
    with Progress(total=len(paths), initial=done, disable=not progress, unit=f"{PART} explorations") as bar:
        for path, job in jobs.items():
            save_snapshots(path, job.result())
            bar.update(1)
    return [snapshot for path in paths for snapshot in load_snapshots(path)]


class _Training:
    """Network, optimizer and number of done steps; begun, or restored from the last checkpoint."""

    def __init__(self, config: CompletionConfig, run: Path) -> None:
        self._config, self._run = config, run
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(config.seed)
            self._network = CompletionNetwork()
        self._mean = copy.deepcopy(self._network)
        self._optimizer = torch.optim.AdamW(self._network.parameters(), config.learning_rate, weight_decay=WEIGHT_DECAY)
        self._validated: list[dict[str, float]] = []
        self.steps = 0
        if checkpoints := list_checkpoints(run):
            self._restore(checkpoints[-1])
        else:
            self._save()
        self._log = SummaryWriter(str(run / "tensorboard"), purge_step=self.steps)

    def fit(self, training: list[Snapshot], validation: list[Snapshot], bar: Progress) -> None:
        """Train to the end, with validations and checkpoints, and write the policy."""
        config, examples = self._config, [_example(one, self._config.horizon) for one in training]
        sizes = np.cumsum([example.codes.size for example in examples]).astype(np.float64)
        kept = [_example(one, BINS[-1]) for one in validation], [floor_distance(one.codes) for one in validation]
        self._network.train()
        while self.steps < config.total_steps:
            loss = self._step(examples, sizes / sizes[-1])
            self.steps += 1
            self._average()
            self._log.add_scalar("train/loss", loss, self.steps)
            bar.update(1)
            if self.steps % config.validate_every == 0 or self.steps == config.total_steps:
                bar.set_postfix(cross_entropy=f"{self._validate(*kept):.4f}")
                self._save()
        self._log.close()
        record = {"seed": config.seed, "steps": self.steps, **self._validated[-1]}
        shutil.rmtree(self._run / POLICY, ignore_errors=True)
        Completion(self._mean).save(self._run / POLICY, record)

    def _step(self, examples: list[Example], shares: np.ndarray) -> float:
        config, rng = self._config, np.random.default_rng([self._config.seed, CROP_STREAM, self.steps])
        crops = [_draw_crop(examples, shares, config.crop, rng) for _ in range(config.batch_size)]
        codes, floor, counts = (np.stack(parts) for parts in zip(*crops, strict=True))
        done = self.steps / config.total_steps
        rate = done / RISE if done < RISE else 0.5 + 0.5 * math.cos(math.pi * (done - RISE) / (1.0 - RISE))
        for group in self._optimizer.param_groups:
            group["lr"] = max(rate, 0.01) * config.learning_rate
        logits, is_used = self._network(channels_of(codes)), torch.from_numpy(counts)
        loss = functional.binary_cross_entropy_with_logits(logits[is_used], torch.from_numpy(floor)[is_used].float())
        self._optimizer.zero_grad()
        loss.backward()
        self._optimizer.step()
        return float(loss.item())

    def _average(self) -> None:
        decay, present = min(DECAY, self.steps / (self.steps + FIRST_STEPS)), self._network.state_dict()
        for name, mean in self._mean.state_dict().items():
            if mean.dtype.is_floating_point:
                mean.lerp_(present[name], 1.0 - decay)
            else:
                mean.copy_(present[name])

    def _validate(self, examples: list[Example], distances: list[np.ndarray]) -> float:
        """Measure the network on other explorations, and draw its calibration; return the mean cross-entropy [nat]."""
        completion = Completion(self._mean)
        predicted = [completion.probabilities(example.codes)[example.counts] for example in examples]
        floor = np.concatenate([example.floor[example.counts] for example in examples])
        distance = np.concatenate([gaps[example.counts] for example, gaps in zip(examples, distances, strict=True)])
        probability = np.concatenate(predicted).clip(1e-6, 1.0 - 1e-6)
        losses = -np.log(np.where(floor, probability, 1.0 - probability))
        is_near = distance <= self._config.horizon
        row = {"steps": float(self.steps), "cross_entropy": float(losses[is_near].mean())}
        for low, high in itertools.pairwise(BINS):
            inside, name = (distance > low) & (distance <= high), f"{low:g}_to_{high:g}_m"
            found, there = probability[inside] > 0.5, floor[inside]
            row[f"precision_{name}"] = float((found & there).sum() / max(found.sum(), 1))
            row[f"recall_{name}"] = float((found & there).sum() / max(there.sum(), 1))
            row[f"iou_{name}"] = float((found & there).sum() / max((found | there).sum(), 1))
        self._validated.append(row)
        write_table(self._run / TABLE, self._validated)
        self._log.add_scalar("validation/cross_entropy", row["cross_entropy"], self.steps)
        write_file(self._run / PICTURE, draw_calibration(probability, floor, distance))
        return row["cross_entropy"]

    def _save(self) -> None:
        folder = own_folder(self._run / "checkpoints") / f"step_{self.steps:09d}"
        tensors = {f"network.{name}": value for name, value in self._network.state_dict().items()}
        tensors |= {f"mean.{name}": value for name, value in self._mean.state_dict().items()}
        for k, moments in self._optimizer.state_dict()["state"].items():
            tensors |= {f"optimizer.{k}.{name}": value for name, value in moments.items()}
        tensors = {name: value.detach().clone().contiguous() for name, value in tensors.items()}
        table = json.dumps(self._validated) + "\n"
        write_folder(folder, {STATE_FILE: safetensors.torch.save(tensors), "validation.json": table})

    def _restore(self, folder: Path) -> None:
        state = defaultdict[Any, dict[str, Tensor]](dict)
        try:
            for name, value in safetensors.torch.load(read_bytes(folder / STATE_FILE)).items():
                owner, rest = name.split(".", 1)
                if owner == "optimizer":
                    index, rest = rest.split(".")
                state[int(index) if owner == "optimizer" else owner][rest] = value
            self._validated = [dict(row) for row in json.loads(read_bytes(folder / "validation.json"))]
            self._network.load_state_dict(state.pop("network"))
            self._mean.load_state_dict(state.pop("mean"))
            self._optimizer.load_state_dict({**self._optimizer.state_dict(), "state": dict(state)})
            self.steps = int(folder.name.removeprefix("step_"))
        except (OSError, ValueError, RuntimeError, KeyError, TypeError, SafetensorError) as error:
            raise CheckpointError(f"{folder} holds no readable training of a completion: {error}") from error


def _example(snapshot: Snapshot, horizon: float) -> Example:
    counts = (snapshot.codes == 0) & (floor_distance(snapshot.codes) <= horizon)
    return Example(snapshot.codes, snapshot.floor, counts)


def _draw_crop(examples: list[Example], shares: np.ndarray, side: int, rng: np.random.Generator) -> list[np.ndarray]:
    """Return a square crop of a random example, turned and reflected at random: three arrays, shape (side, side).

    They hold the codes of the known map (input), the true floor (target), and the cells that count in the loss.
    `shares`: cumulative probabilities of the examples, in proportion to their sizes. Crops may overlap the border.
    """
    while True:
        example = examples[int(np.searchsorted(shares, rng.random()))]
        corner = [int(rng.integers(-STRIDE, max(size - side, 0) + STRIDE + 1)) for size in example.codes.shape]
        window = tuple(slice(max(low, 0), max(low + side, 0)) for low in corner)
        parts = []
        for raster in example:
            inner, part = raster[window], np.zeros((side, side), dtype=raster.dtype)
            top, left = (max(-low, 0) for low in corner)
            part[top : top + inner.shape[0], left : left + inner.shape[1]] = inner
            parts.append(part)
        if np.count_nonzero(parts[2]) >= LEAST_CELLS:
            break
    turns, is_mirrored = int(rng.integers(4)), rng.random() < 0.5
    return [np.ascontiguousarray(np.rot90(part.T if is_mirrored else part, turns)) for part in parts]


def draw_calibration(probability: np.ndarray, floor: np.ndarray, distance: np.ndarray) -> bytes:
    """Return a picture (PNG) of true frequencies over predicted probabilities, by distance from known floor.

    `probability`, `floor`, `distance`: shape (n,), of unknown cells; distances in metres.
    """
    from matplotlib.figure import Figure

    figure, picture = Figure(figsize=(5.2, 4.6), dpi=120, layout="constrained"), io.BytesIO()
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], color="0.6", linewidth=1)
    for low, high in itertools.pairwise(BINS):
        inside = (distance > low) & (distance <= high)
        level = np.digitize(probability[inside], LEVELS[1:-1])
        count = np.bincount(level, minlength=len(LEVELS) - 1).clip(1)
        mean, true = (np.bincount(level, values[inside], len(LEVELS) - 1) / count for values in (probability, floor))
        axes.plot(mean, true, marker="o", label=f"{low:g} to {high:g} m from known floor")
    axes.set(xlabel="predicted probability of floor", ylabel="true frequency", xlim=(0, 1), ylim=(0, 1))
    axes.legend()
    axes.grid(alpha=0.3)
    figure.savefig(picture)
    return picture.getvalue()

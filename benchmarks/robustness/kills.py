"""Trainings and evaluations that are killed again and again: what they lose, and what they come to in the end."""

import csv
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import yaml

from envs.progress import Progress

from . import ROOT, Report

CONFIG = {
    "experiment": "killed",
    "total_steps": 4096,
    "num_envs": 4,
    "algorithm": "PPO",
    "environment": {"world": "rooms", "world_size": [6.0, 6.0], "num_workers": 0, "time_limit": 10.0},
    "hyperparameters": {"n_steps": 32, "batch_size": 64, "n_epochs": 2},
    "network": {"features": 16, "channels": 4, "hidden": 16},
    "evaluation": {"every": 2048, "episodes": 1, "references": []},
    "checkpoints": {"every": 128, "keep": 2},
}
"""A training of 32 updates, with a checkpoint after each."""
EVALUATION = (
    "--policies", "random", "nearest", "--worlds", "turtlebot3_world", "--episodes", "10", "--physics", "kinematic",
    "--slam", "truth", "--time-limit", "6", "--shard", "1/1", "--out",
)  # fmt: skip
UNTIMED = "decision_ms"
"""Column of an evaluation that depends on the clock."""


def kill_all(count: int, seed: int) -> Report:
    """Kill a training and an evaluation at `count` random moments each; start each again until it ends.

    Raises:
        RuntimeError: one of them failed.
    """
    rows, failures = [], []
    for what, kill in (("training", kill_training), ("evaluation", kill_evaluation)):
        with tempfile.TemporaryDirectory() as folder:
            victim = Victim(Path(folder), what, count, np.random.default_rng([seed, what == "training"]))
            kill(victim)
        row = {"kill -9 of": what, "kills": victim.kills, "runs that ended and were compared": victim.ends}
        rows.append({**row, "lost": len(victim.lost)})
        failures += [f"{what}: {lost}" for lost in victim.lost]
    return rows, failures


class Victim:
    """A command that is killed, how often it was, and how often it came to its end; `lost` is what should be empty."""

    def __init__(self, folder: Path, what: str, count: int, rng: np.random.Generator) -> None:
        self.folder, self._count, self._rng = folder, count, rng
        self.kills, self.ends, self.lost, self._duration = 0, 0, list[str](), 0.0
        self._bar = Progress(total=count, desc=f"kills of a {what}", unit="kill")

    def run(self, *command: object, limit: float | None = None) -> bool:
        """Run a program of the checkout and tell whether it ended; it did not if it was killed after `limit` [s]."""
        begin, program = time.perf_counter(), [sys.executable, *map(str, command)]
        with (self.folder / "said.txt").open("w+") as said:
            environment = {**os.environ, "PYTHONPATH": str(ROOT)}
            process = subprocess.Popen(program, cwd=self.folder, env=environment, stdout=said, stderr=said)
            try:
                process.wait(limit)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
                return False
            if process.returncode:
                said.seek(0)
                raise RuntimeError(f"{' '.join(program)} failed: {said.read()[-2000:]}")
        self._duration = self._duration or time.perf_counter() - begin
        return True

    def run_or_kill(self, *command: object) -> bool:
        """Kill a program at a random moment, or let it end if it was killed often enough; tell whether it ended."""
        ended = self.run(*command, limit=None if self.is_done else self._rng.uniform(0.0, self._duration))
        self.kills += not ended
        self.ends += ended
        self._bar.update(not ended)
        return ended

    @property
    def is_done(self) -> bool:
        """Whether it was killed often enough."""
        return self.kills >= self._count

    def compare(self, wanted: dict[str, bytes], found: dict[str, bytes], what: str, folder: Path) -> None:
        """Note what differs, and what is left over in the folder, which is removed."""
        names = sorted(name for name in wanted.keys() | found.keys() if wanted.get(name) != found.get(name))
        self.lost += [f"{len(names)} {what} differ: {', '.join(names[:3])}"] if names else []
        self.lost += [f"{path.name} is left over" for path in folder.rglob("*.tmp")]
        shutil.rmtree(folder)


def kill_evaluation(victim: Victim) -> None:
    """No row may get lost or be there twice, and the end is that of an evaluation that nobody disturbed."""
    command = [ROOT / "evaluate.py", *EVALUATION]
    whole, out, seen = victim.folder / "whole", victim.folder / "killed", set[tuple[str, ...]]()
    victim.run(*command, whole)
    while not victim.is_done or out.is_dir():
        ended = victim.run_or_kill(*command, out)
        rows = _rows(out)
        victim.lost += [f"row {row} is gone" for row in seen - set(rows)]
        victim.lost += ["double rows"] * (len(set(rows)) != len(rows))
        seen |= set(rows)
        if ended:
            victim.compare(_files(whole), _files(out), "rows or traces", out)
            seen.clear()


def kill_training(victim: Victim) -> None:
    """No checkpoint may be lost.

    A training that is resumed starts new episodes. So the bytes that it comes to are compared with those of a training
    that goes on, undisturbed, from a copy of the same checkpoint.
    """
    from agents.checkpoint import load_checkpoint
    from agents.run_folder import CheckpointError, list_checkpoints

    def tensors(run: Path) -> dict[str, bytes]:
        return {path.name: path.read_bytes() for path in list_checkpoints(run)[-1].glob("*.safetensors")}

    folder, reached, program = victim.folder, 0, ROOT / "train.py"
    (folder / "killed.yaml").write_text(yaml.safe_dump(CONFIG))
    begin = [program, "--config", "killed.yaml", "--seed", "1"]
    victim.run(*begin)
    run, copied, whole = (folder / name for name in ("killed", "copied", "whole"))
    next((folder / "runs").iterdir()).rename(whole)
    while not victim.is_done or run.is_dir():
        wanted = shutil.copytree(run, copied) if run.is_dir() else whole
        ended = victim.run_or_kill(*([program, "--resume", run] if run.is_dir() else begin))
        for begun in (folder / "runs").glob("*"):
            # A run that was killed before its first checkpoint holds nothing to go on from.
            begun.rename(run) if list_checkpoints(begun) else shutil.rmtree(begun)
        try:
            steps = max((load_checkpoint(path).record.steps for path in list_checkpoints(run)), default=0)
        except CheckpointError as error:
            victim.lost.append(str(error))
            steps = reached
        victim.lost += [f"{reached - steps} steps"] * (steps < reached)
        reached = 0 if ended else steps
        if ended:
            if wanted == copied:
                victim.run(program, "--resume", copied)
            victim.compare(tensors(wanted), tensors(run), "files of the last checkpoint", run)
        shutil.rmtree(copied, ignore_errors=True)


def _rows(folder: Path) -> list[tuple[str, ...]]:
    """Return the whole rows of an evaluation, its header first, without the column that depends on the clock."""
    path = next(iter(folder.glob("episodes*.csv")), None)
    content = path.read_text() if path else ""
    lines = list(csv.reader(content[: content.rfind("\n") + 1].splitlines()))
    skipped = lines[0].index(UNTIMED) if lines else 0
    return [tuple(value for k, value in enumerate(line) if k != skipped) for line in lines]


def _files(folder: Path) -> dict[str, bytes]:
    """Return the rows and the traces of an evaluation."""
    traces = {path.name: path.read_bytes() for path in (folder / "episodes").iterdir() if path.is_file()}
    return traces | {" ".join(row[:6]): repr(row).encode() for row in _rows(folder)}

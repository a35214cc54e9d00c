"""Trainings and evaluations that are killed again and again: what they lose, and what they come to in the end."""

import csv
import os
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import yaml

from agents.checkpoint import load_checkpoint
from agents.run_folder import CheckpointError, list_checkpoints
from envs.progress import Progress

ROOT = Path(__file__).parents[2]
"""Folder of the checkout."""
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
POLICIES, EPISODES = ("random", "nearest"), 10
"""Of the evaluation that is killed."""
UNTIMED = "decision_ms"
"""Column of an evaluation that depends on the clock."""


@dataclass
class Killed:
    """What became of a command that was killed."""

    what: str
    kills: int = 0
    """How often it was killed while it ran."""
    ends: int = 0
    """How often it came to its end, killed before or not, and was compared with one that nobody disturbed."""
    lost: list[str] = field(default_factory=list)
    """What was missing, damaged or different; nothing is what is wanted."""


def kill_evaluation(count: int, seed: int, folder: Path, *, progress: bool = True) -> Killed:
    """Kill evaluations at `count` random moments, and start each again until it ends.

    Raises:
        RuntimeError: an evaluation failed.
    """
    options = ["--policies", *POLICIES, "--worlds", "turtlebot3_world", "--episodes", str(EPISODES)]
    options += ["--physics", "kinematic", "--slam", "truth", "--time-limit", "6", "--shard", "1/1"]
    command = [sys.executable, str(ROOT / "evaluate.py"), *options, "--out"]
    whole, out = folder / "whole", folder / "killed"
    duration = _run([*command, str(whole)], folder)
    result, seen, rng = Killed("evaluation"), set(), np.random.default_rng([seed, 0])
    bar = Progress(total=count, desc="kills of evaluate.py", unit="kill", disable=not progress)
    while result.kills < count or out.is_dir():
        ended = _run_or_kill([*command, str(out)], folder, duration, rng, result, count)
        bar.update(not ended)
        rows = _rows(out)
        result.lost += [f"row {row} is gone" for row in seen - rows]
        seen |= rows
        if ended:
            result.lost += _differences(_table(whole), _table(out), "rows")
            result.lost += ["double rows"] * (len(_lines(out)) != len(rows))
            result.lost += _differences(_files(whole / "episodes"), _files(out / "episodes"), "traces")
            result.lost += [f"{path.name} is left over" for path in out.rglob("*.tmp")]
            shutil.rmtree(out)
            seen.clear()
    bar.close()
    return result


def kill_training(count: int, seed: int, folder: Path, *, progress: bool = True) -> Killed:
    """Kill trainings at `count` random moments, and resume each until it ends; no checkpoint may be lost.

    A training that is resumed starts new episodes. So the bytes that it comes to are compared with those of a training
    that goes on, undisturbed, from a copy of the same checkpoint.

    Raises:
        RuntimeError: a training failed.
    """
    (folder / "killed.yaml").write_text(yaml.safe_dump(CONFIG))
    begin = [sys.executable, str(ROOT / "train.py"), "--config", "killed.yaml", "--seed", "1"]
    duration = _run(begin, folder)
    (whole,) = (folder / "runs").iterdir()
    whole = whole.rename(folder / "whole")
    run, copied = folder / "killed", folder / "copied"
    result, reached, rng = Killed("training"), 0, np.random.default_rng([seed, 1])
    bar = Progress(total=count, desc="kills of train.py", unit="kill", disable=not progress)
    while result.kills < count or run.is_dir():
        wanted = shutil.copytree(run, copied) if run.is_dir() else whole
        ended = _run_or_kill(_resume(run) if run.is_dir() else begin, folder, duration, rng, result, count)
        bar.update(not ended)
        for begun in (folder / "runs").glob("*"):
            # A run that was killed before its first checkpoint holds nothing to go on from.
            begun.rename(run) if list_checkpoints(begun) else shutil.rmtree(begun)
        steps = _steps(run, result)
        result.lost += [f"{reached - steps} steps"] * (steps < reached)
        reached = steps
        if ended:
            if wanted == copied:
                _run(_resume(copied), folder)
            result.lost += _differences(_tensors(wanted), _tensors(run), "files of the last checkpoint")
            result.lost += [f"{path.name} is left over" for path in run.rglob("*.tmp")]
            shutil.rmtree(run)
            reached = 0
        shutil.rmtree(copied, ignore_errors=True)
    bar.close()
    return result


def _run_or_kill(
    command: list[str], folder: Path, duration: float, rng: np.random.Generator, result: Killed, count: int
) -> bool:
    """Kill a command at a random moment, or let it end if `count` is reached; count it, and tell whether it ended."""
    limit = rng.uniform(0.0, duration) if result.kills < count else None
    ended = _run(command, folder, limit) is not None
    result.kills += not ended
    result.ends += ended
    return ended


def _run(command: list[str], folder: Path, limit: float | None = None) -> float | None:
    """Run a command and return how long it took [s]; None if it was killed since it ran longer than `limit` [s].

    Raises:
        RuntimeError: it failed.
    """
    begin = time.perf_counter()
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with (folder / "said.txt").open("w+") as said:
        process = subprocess.Popen(command, cwd=folder, env=environment, stdout=said, stderr=said)
        try:
            process.wait(limit)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            return None
        if process.returncode:
            said.seek(0)
            raise RuntimeError(f"{' '.join(command)} failed: {said.read()[-2000:]}")
    return time.perf_counter() - begin


def _resume(run: Path) -> list[str]:
    return [sys.executable, str(ROOT / "train.py"), "--resume", str(run)]


def _steps(run: Path, result: Killed) -> int:
    """Return the steps of the newest checkpoint of a run, 0 without one; one that cannot be read is lost."""
    try:
        return max((load_checkpoint(path).record.steps for path in list_checkpoints(run)), default=0)
    except CheckpointError as error:
        result.lost.append(str(error))
        return 0


def _lines(folder: Path) -> list[list[str]]:
    """Return the whole rows of an evaluation, its header first."""
    path = next(iter(folder.glob("episodes*.csv")), None)
    content = path.read_text() if path else ""
    return list(csv.reader(content[: content.rfind("\n") + 1].splitlines()))


def _rows(folder: Path) -> set[tuple[str, ...]]:
    """Return the rows of an evaluation, without the column that depends on the clock."""
    lines = _lines(folder)
    skipped = lines[0].index(UNTIMED) if lines else 0
    return {tuple(value for k, value in enumerate(line) if k != skipped) for line in lines}


def _table(folder: Path) -> dict[str, bytes]:
    return {" ".join(row[:6]): repr(row).encode() for row in _rows(folder)}


def _files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def _tensors(run: Path) -> dict[str, bytes]:
    """Return the tensors of the last checkpoint of a run, by their files."""
    last = list_checkpoints(run)[-1]
    return {f"{last.name}/{name}": content for name, content in _files(last).items() if name.endswith(".safetensors")}


def _differences(wanted: dict[str, bytes], found: dict[str, bytes], what: str) -> list[str]:
    names = sorted(name for name in wanted.keys() | found.keys() if wanted.get(name) != found.get(name))
    return [f"{len(names)} {what} differ: {', '.join(names[:3])}"] if names else []

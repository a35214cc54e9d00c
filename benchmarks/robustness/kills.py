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
from tqdm import tqdm

ROOT = Path(__file__).parents[2]
"""Folder of the checkout."""
CONFIG = {
    "experiment": "killed",
    "total_steps": 4096,
    "num_envs": 4,
    "environment": {"world_size": [6.0, 6.0], "num_workers": 0, "time_limit": 10.0},
    "ppo": {"num_steps": 32, "batch_size": 64, "num_epochs": 2},
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
    kills: int
    """How often it was killed while it ran; the other times it had just ended."""
    lost: list[str] = field(default_factory=list)
    """What was missing, damaged or different; nothing is what is wanted."""


def kill_evaluation(count: int, seed: int, folder: Path, *, progress: bool = True) -> Killed:
    """Kill an evaluation at `count` random moments and let it end; compare it with one that nobody disturbed."""
    options = ["--policies", *POLICIES, "--worlds", "turtlebot3_world", "--episodes", str(EPISODES)]
    options += ["--physics", "kinematic", "--slam", "truth", "--time-limit", "6", "--shard", "1/1"]
    command = [sys.executable, str(ROOT / "evaluate.py"), *options, "--out"]
    whole, out = folder / "whole", folder / "killed"
    duration = _finish([*command, str(whole)], folder)
    result, seen = Killed("evaluation", 0), set()
    rng = np.random.default_rng([seed, 0])
    for _ in tqdm(range(count), desc="kills of evaluate.py", unit="kill", disable=not progress):
        result.kills += _kill([*command, str(out)], folder, rng.uniform(0.0, duration))
        rows = _rows(out)
        result.lost += [f"row {row} is gone" for row in seen - rows]
        seen |= rows
    _finish([*command, str(out)], folder)
    result.lost += _differences(_table(whole), _table(out), "rows")
    if len(_lines(out)) != len(_rows(out)):
        result.lost.append("double rows")
    result.lost += _differences(_files(whole / "episodes"), _files(out / "episodes"), "traces")
    result.lost += [f"{path.name} is left over" for path in out.rglob("*.tmp")]
    return result


def kill_training(count: int, seed: int, folder: Path, *, progress: bool = True) -> Killed:
    """Kill a training at `count` random moments; no checkpoint may be lost, and resuming depends on it alone.

    A training that goes on from a checkpoint starts new episodes. So the bytes that it comes to are compared with those
    of a training that goes on, undisturbed, from a copy of the same checkpoint.
    """
    from agents.checkpoint import load_checkpoint
    from agents.run_folder import CheckpointError, list_checkpoints

    (folder / "killed.yaml").write_text(yaml.safe_dump(CONFIG))
    train = [sys.executable, str(ROOT / "train.py")]
    duration = _finish([*train, "--config", "killed.yaml", "--seed", "1"], folder)
    (whole,) = (folder / "runs").iterdir()
    whole = whole.rename(folder / "whole")
    result, run, reached = Killed("training", 0), folder / "killed", 0
    rng = np.random.default_rng([seed, 1])
    for _ in tqdm(range(count), desc="kills of train.py", unit="kill", disable=not progress):
        command = [*train, "--resume", str(run)] if run.is_dir() else [*train, "--config", "killed.yaml", "--seed", "1"]
        result.kills += _kill(command, folder, rng.uniform(0.0, duration))
        for begun in (folder / "runs").glob("*"):
            # A run that was killed before its first checkpoint holds nothing to go on from.
            begun.rename(run) if list_checkpoints(begun) else shutil.rmtree(begun)
        try:
            checkpoints = list_checkpoints(run)
            steps = max((load_checkpoint(checkpoint).record.steps for checkpoint in checkpoints), default=0)
        except CheckpointError as error:
            result.lost.append(str(error))
            continue
        if steps < reached:
            result.lost.append(f"{reached - steps} steps")
        reached = max(steps, reached)
    if not run.is_dir():
        shutil.copytree(whole, run)
    copied = shutil.copytree(run, folder / "copied")
    for resumed in (run, copied):
        _finish([*train, "--resume", str(resumed)], folder)
    last = [list_checkpoints(one)[-1] for one in (run, copied, whole)]
    if len({path.name for path in last}) > 1:
        result.lost.append(f"ends at {[path.name for path in last]}")
    result.lost += _differences(_tensors(last[0]), _tensors(last[1]), "files of the last checkpoint")
    result.lost += [f"{path.name} is left over" for path in run.rglob("*.tmp")]
    return result


def _finish(command: list[str], folder: Path) -> float:
    """Run a command to its end and return how long it took [s].

    Raises:
        RuntimeError: it failed.
    """
    begin = time.perf_counter()
    done = subprocess.run(command, cwd=folder, env=_environment(), capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)} failed: {done.stderr[-2000:]}")
    return time.perf_counter() - begin


def _kill(command: list[str], folder: Path, after: float) -> bool:
    """Run a command, kill it after a time [s], and tell whether it still ran."""
    process = subprocess.Popen(
        command, cwd=folder, env=_environment(), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        process.wait(after)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        return True
    return False


def _environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT)}


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


def _tensors(folder: Path) -> dict[str, bytes]:
    return {name: content for name, content in _files(folder).items() if name.endswith(".safetensors")}


def _differences(wanted: dict[str, bytes], found: dict[str, bytes], what: str) -> list[str]:
    names = sorted(name for name in wanted.keys() | found.keys() if wanted.get(name) != found.get(name))
    return [f"{len(names)} {what} differ: {', '.join(names[:3])}"] if names else []

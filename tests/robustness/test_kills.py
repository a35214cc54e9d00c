import csv
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml

from lidarnaut.agents.checkpoint import load_checkpoint
from lidarnaut.agents.run_folder import list_checkpoints

ROOT = Path(__file__).parents[2]
CONFIG = {
    "experiment": "killed",
    "recipe": None,
    "total_steps": 4096,
    "num_envs": 4,
    "algorithm": "PPO",
    "environment": {"world": "rooms", "world_size": [6.0, 6.0], "num_workers": 0, "time_limit": 10.0},
    "hyperparameters": {"n_steps": 32, "batch_size": 64, "n_epochs": 2},
    "network": {"features": 16, "channels": 4, "hidden": 16},
    "evaluation": {"every": 2048, "episodes": 1, "references": []},
    "checkpoints": {"every": 128, "keep": 2},
}
EVALUATION = (
    "--policies", "random", "nearest", "--worlds", "turtlebot3_world", "--episodes", "10", "--physics", "kinematic",
    "--slam", "truth", "--time-limit", "6", "--shard", "1/1", "--out",
)  # fmt: skip
KILLS = 20
pytestmark = pytest.mark.slow


class Killer:
    """Runs programs in a folder and kills them at random moments, `KILLS` times."""

    def __init__(self, folder):
        self.folder, self.rng, self.kills, self.ends, self.duration = folder, np.random.default_rng(0), 0, 0, None

    def run(self, *command, limit=None):
        """Run a program; return True if it ended, False if it was killed after `limit` [s]."""
        began, program = time.perf_counter(), [sys.executable, *map(str, command)]
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        try:
            subprocess.run(program, cwd=self.folder, env=environment, timeout=limit, check=True, capture_output=True)
        except subprocess.TimeoutExpired:
            return False
        self.duration = self.duration or time.perf_counter() - began
        return True

    def run_or_kill(self, *command):
        ended = self.run(*command, limit=None if self.is_done else self.rng.uniform(0.0, self.duration))
        self.kills += not ended
        self.ends += ended
        return ended

    @property
    def is_done(self):
        return self.kills >= KILLS


def rows_of(folder):
    """Return the complete rows of an evaluation without the column that depends on the clock."""
    content = next((path.read_text() for path in folder.glob("episodes*.csv")), "")
    lines = list(csv.reader(content[: content.rfind("\n") + 1].splitlines()))
    skipped = lines[0].index("decision_ms") if lines else 0
    return [(*line[:skipped], *line[skipped + 1 :]) for line in lines]


def traces_of(folder):
    return {path.name: path.read_bytes() for path in (folder / "episodes").iterdir() if path.is_file()}


def leftovers(folder):
    return [path.name for path in folder.rglob("*.tmp")]


def test_no_row_of_a_killed_evaluation_is_lost_or_there_twice(tmp_path, row):
    killer, command, seen = Killer(tmp_path), [ROOT / "evaluate.py", *EVALUATION], set()
    whole, out = tmp_path / "whole", tmp_path / "killed"
    killer.run(*command, whole)
    while not killer.is_done or out.is_dir():
        ended = killer.run_or_kill(*command, out)
        rows = rows_of(out)
        assert seen <= set(rows)
        assert len(set(rows)) == len(rows)
        seen = set(rows)
        if ended:
            assert sorted(rows) == sorted(rows_of(whole))
            assert traces_of(out) == traces_of(whole)
            assert not leftovers(out)
            shutil.rmtree(out)
            seen = set()
    row("killed (kill -9)", program="evaluation", kills=killer.kills, ends_compared=killer.ends)


def test_no_checkpoint_of_a_killed_training_is_lost(tmp_path, row):
    """A resumed training ends like an undisturbed training from a copy of the same checkpoint."""

    def tensors(run):
        return {path.name: path.read_bytes() for path in list_checkpoints(run)[-1].glob("*.safetensors")}

    killer, program, reached = Killer(tmp_path), ROOT / "train.py", 0
    (tmp_path / "killed.yaml").write_text(yaml.safe_dump(CONFIG))
    begin = [program, "--config", "killed.yaml", "--seed", "1"]
    killer.run(*begin)
    run, copied, whole = (tmp_path / name for name in ("killed", "copied", "whole"))
    next((tmp_path / "runs").iterdir()).rename(whole)
    while not killer.is_done or run.is_dir():
        resumes = run.is_dir()
        if resumes:
            shutil.copytree(run, copied)
        ended = killer.run_or_kill(*([program, "--resume", run] if resumes else begin))
        for begun in (tmp_path / "runs").glob("*"):
            begun.rename(run) if list_checkpoints(begun) else shutil.rmtree(begun)
        steps = max((load_checkpoint(path, trust="tests").record.steps for path in list_checkpoints(run)), default=0)
        assert steps >= reached
        reached = steps
        if ended:
            if resumes:
                killer.run(program, "--resume", copied)
            assert tensors(run) == tensors(copied if resumes else whole)
            assert not leftovers(run)
            shutil.rmtree(run)
            reached = 0
        shutil.rmtree(copied, ignore_errors=True)
    row("killed (kill -9)", program="training", kills=killer.kills, ends_compared=killer.ends)

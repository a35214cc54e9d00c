import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from lidarnaut.agents import references
from lidarnaut.agents.checkpoint import POLICY_FILE, load_checkpoint
from lidarnaut.agents.curves import read_evaluations
from lidarnaut.agents.run_folder import list_checkpoints
from lidarnaut.agents.training import train
from tests.agents.tiny import tiny


def reach(**changes):
    environment = {"id": "lidarnaut/ReachGoal-v0", "world": "hall", "world_size": [6, 6], "time_limit": 2.0}
    evaluation = {"every": 16, "episodes": 2, "test_episodes": 3, "references": ["pursuit", "random"]}
    return tiny("PPO", "Explore", environment={**environment, "num_workers": 0, **changes}, evaluation=evaluation)


@pytest.fixture
def no_workers():
    """Use workers."""


@pytest.fixture
def cache(monkeypatch, tmp_path):
    """Folder of cached references."""
    monkeypatch.setattr(references, "_cache_folder", lambda: tmp_path / "cache")
    return tmp_path / "cache"


def rows_of(run):
    return [(row["policy"], row["split"], row["scores"]) for row in read_evaluations(run)]


def checkpoints_of(run):
    folders = list_checkpoints(run)
    return [(one.name, load_checkpoint(one).record.evaluations, (one / POLICY_FILE).read_bytes()) for one in folders]


def test_a_second_training_measures_only_what_is_not_cached_and_gives_the_same(cache, tmp_path, monkeypatch):
    first = train(reach(), run=tmp_path / "first", progress=False)
    wholes = {path: path.read_text() for path in cache.iterdir()}
    assert len(wholes) == 2
    monkeypatch.setattr(references, "make_pool", None)
    second = train(reach(num_workers=2), run=tmp_path / "second", progress=False)
    assert rows_of(second) == rows_of(first)
    assert [policy for policy, *_ in rows_of(first)][:3] == ["pursuit", "random", "learned"]
    assert checkpoints_of(second) == checkpoints_of(first)
    # Damaged files are ignored.
    path, *_ = wholes
    for damage in ("", "[]", '{"episodes": 3}', '{"episodes": [{"sct": "x"}]}', "[" * 100_000):
        path.write_text(damage)
        assert references._read(path, ["sct"]) == []
    monkeypatch.setattr(references, "make_pool", lambda *_: ThreadPoolExecutor(1))
    third = train(reach(), run=tmp_path / "third", progress=False)
    assert rows_of(third) == rows_of(first)
    assert {path: path.read_text() for path in wholes} == wholes


def test_what_changes_the_episodes_changes_the_cache(cache, tmp_path):
    plain = references._cache_file(reach(), "random")
    assert plain.parent == cache
    assert references._cache_file(reach(num_workers=3), "random") == plain
    others = [reach(world_size=[7, 7]), reach(reward={"time": -1.0}), reach(people=2)]
    files = {references._cache_file(one, "random") for one in others} | {references._cache_file(reach(), "dwb")}
    assert len(files | {plain}) == 5
    world = tmp_path / "house.yaml"
    world.write_text("a: 1")
    before = references._cache_file(reach(world=str(world)), "random")
    world.write_text("a: 2")
    assert references._cache_file(reach(world=str(world)), "random") != before
    # Code and objects of a user may change without notice.
    assert references._cache_file(reach(world="my_lab:WORLD"), "random") is None
    assert references._cache_file(reach(), "my_lab:Policy") is None
    assert references._cache_file(reach(people=object()), "random") is None


def test_a_script_without_a_guard_trains_once(tmp_path):
    """Workers import the script; the references are then measured in the main process."""
    config = {"experiment": "a", "recipe": None, "algorithm": "PPO", "total_steps": 16, "num_envs": 2}
    config |= {"hyperparameters": {"n_steps": 8, "batch_size": 8}, "environment": reach().environment.model_dump()}
    config["evaluation"] = {"episodes": 1, "references": ["tests.own_code:Circling"]}
    (tmp_path / "script.py").write_text(f"import lidarnaut\nlidarnaut.train({config!r}, progress=False)\n")
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    done = subprocess.run([sys.executable, "script.py"], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    (run,) = (tmp_path / "runs").iterdir()
    assert [policy for policy, *_ in rows_of(run)] == ["tests.own_code:Circling", *["learned"] * 3]

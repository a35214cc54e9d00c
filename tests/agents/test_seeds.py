import csv
import json
import re
import shutil
import sys
from pathlib import Path

import pytest

import lidarnaut
from lidarnaut import train_command as train
from lidarnaut.agents import learning
from lidarnaut.agents.config import EvolutionConfig, TrainingConfig, parse_config
from lidarnaut.agents.run_folder import CheckpointError, prepare_folder
from lidarnaut.agents.seeds import expand, read_members, train_seeds
from lidarnaut.envs.files import read_record
from tests.agents.frontiers.test_evolution import TINY as EVOLUTION
from tests.agents.frontiers.test_evolution import shrink


def read_table(path, *columns):
    with open(path, newline="") as file:
        return [[float(row[name]) for name in columns] for row in csv.DictReader(file)]


BRIEF = {"total_steps": 128, "evaluation": {"every": 128, "episodes": 1, "references": []}}


@pytest.fixture
def data(tiny_data):
    return tiny_data | BRIEF | {"seeds": [0, 1]}


def test_each_seed_is_trained_and_joined_in_a_table_and_a_picture(data, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tiny.yaml").write_text(json.dumps(data))
    assert train.main(["--config", "tiny.yaml", "--evaluation.every", "64", "--seeds", "3", "5"]) == 0
    (folder,) = (tmp_path / "runs").glob("tiny__sweep__*")
    assert read_table(folder / "sweep.csv", "seed", "steps") == [[3, 128], [5, 128]]
    times = read_table(folder / "sweep.csv", "processor_time")
    assert all(0.0 < seconds < 60.0 for (seconds,) in times)
    assert (folder / "sweep.png").read_bytes().startswith(b"\x89PNG")
    assert re.search(r"2 +. 128 +. [\d.e-]+ +. \[[\d.e-]+, [\d.e-]+\]", capsys.readouterr().out)
    trained = []
    monkeypatch.setattr("lidarnaut.agents.learning.run_training", lambda config, **how: trained.append(how["resume"]))
    assert train.main(["--resume", str(folder), "--trust", "tests"]) == 0
    assert trained == []
    assert [(member.config.seed, member.run.name) for member in read_members(folder)] == [(3, "seed_3"), (5, "seed_5")]
    assert read_table(folder / "sweep.csv", "processor_time") == times
    assert train.main(["--resume", str(folder), "--trust", "tests", "--total-steps", "256"]) == 0
    assert trained == [folder / "seed_3", folder / "seed_5"]
    assert read_members(folder) == []


BUGS = """
import os, pathlib, sys, torch
from lidarnaut.agents.networks import ExplorerFeatures

def reward_fault():
    kind = pathlib.Path("bug").read_text()
    if kind == "kill":
        os.kill(os.getpid(), 9)
    if kind == "exit":
        sys.exit("gone")
    if kind == "key":
        raise KeyError("a bug of mine")

class Features(ExplorerFeatures):
    def forward(self, observations):
        if torch.initial_seed() == 0:
            reward_fault()
        return super().forward(observations)
"""


FOUND = {
    "key": "KeyError: 'a bug of mine' (traceback: ",
    "exit": "SystemExit: gone (traceback: ",
    "kill": "BrokenProcessPool: A process in the process pool was terminated abruptly",
}


def test_a_bug_of_any_kind_fails_one_training_until_it_is_fixed(data, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "bugs", raising=False)
    (tmp_path / "bugs.py").write_text(BUGS)
    own = {"policy_kwargs": {"features_extractor_class": "bugs:Features"}}
    (tmp_path / "tiny.yaml").write_text(json.dumps(data | {"hyperparameters": data["hyperparameters"] | own}))
    command, good = ["--config", "tiny.yaml"], None
    for bug, says in FOUND.items():
        (tmp_path / "bug").write_text(bug)
        assert train.main(command) == 2
        (folder,) = Path("runs").iterdir()
        first, second = capsys.readouterr().err.strip().splitlines()[-2:]
        again = f"--resume {folder} --trust bugs:Features tests.agents.fake_env:Fake-v0"
        assert f"1 of 2 trainings failed; retry with {again}:" in first
        assert second.startswith(f"seed_0: {says}")
        assert (folder / "seed_1" / "checkpoints" / "step_000000128").is_dir()
        kept = folder / "seed_0.traceback.txt"
        assert kept.exists() == (bug != "kill")
        if kept.exists():
            assert "bugs.py" in kept.read_text()
        assert len(read_table(folder / "sweep.csv")) == 1
        good = good or (folder / "seed_1" / "processor_time").read_text()
        jobs = "2" if bug == "exit" else "1"  # the last bug kills its process
        command = ["--resume", str(folder), "--jobs", jobs, "--trust", "bugs", "tests"]
    (tmp_path / "bug").write_text("")
    assert train.main(command) == 0
    assert (folder / "seed_0" / "checkpoints" / "step_000000128").is_dir()
    assert (folder / "seed_1" / "processor_time").read_text() == good
    assert not kept.exists()


@pytest.fixture
def copies(tiny_data, tmp_path_factory, monkeypatch):
    """Trainings that copy a finished one, with their own configuration."""
    config = parse_config(tiny_data | BRIEF, "tiny")
    source = learning.run_training(config, run=tmp_path_factory.mktemp("runs") / "source", progress=False)
    whole = read_record(source / "config.yaml", TrainingConfig)

    def copy(config, *, run, **_):
        shutil.copytree(source, run, ignore=shutil.ignore_patterns(".lock"))
        values = {"hyperparameters": whole.hyperparameters | config.hyperparameters, "network": whole.network}
        prepare_folder(run, config.model_copy(update=values))

    monkeypatch.setattr(learning, "run_training", copy)


def test_a_sweep_goes_on_with_more_seeds_and_with_no_other_settings(data, copies, tmp_path):
    folder = tmp_path / "sweep"
    assert lidarnaut.train(data, run=folder, progress=False) == folder
    swept = (folder / "sweep.yaml").read_text()
    for changes, says in (
        ({"seeds": [1]}, "seed_0 is no longer in the sweep: seeds may only be added"),
        ({"hyperparameters": {"n_steps": 16}}, "hyperparameters.n_steps: 32"),
        ({"seed": 1}, "seed: 'the default', not 1"),
        ({"environment": {**data["environment"], "world": "caves"}}, "environment.world: .the default., "),
        ({"environment": {"id": data["environment"]["id"]}}, "environment.time_limit: 4.0, not 'the def"),
        ({"total_steps": 64}, "128 of total_steps, more than 64"),
    ):
        with pytest.raises(CheckpointError, match=says):
            train_seeds(data | changes, "mem", run=folder, progress=False)
    assert (folder / "sweep.yaml").read_text() == swept
    times = {path: path.read_text() for path in folder.glob("*/processor_time")}
    more = {"seeds": [2, 0, 1], "checkpoints": {"every": 128}}
    lidarnaut.train(resume=folder, changes=more, trust=["tests"], progress=False)
    assert read_table(folder / "sweep.csv", "seed") == [[2], [0], [1]]
    assert times == {path: path.read_text() for path in times}


def test_a_single_run_does_not_become_a_sweep(data, tiny_run):
    with pytest.raises(ValueError, match="jobs must be at least 1, got 0"):
        train_seeds(data, "mem", run=tiny_run, jobs=0, progress=False)
    with pytest.raises(CheckpointError, match="tiny holds a single run: seeds may not change"):
        train_seeds(data, "mem", run=tiny_run, progress=False)
    assert not (tiny_run / "sweep.yaml").exists()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"seeds": 3}, "seeds must be a list of whole numbers, got 3"),
        ({"seeds": []}, r"seeds must be a list of whole numbers, got \[\]"),
        ({"seeds": [0, "x"]}, "seed: .*integer"),
        ({"seeds": [1, 0, 1]}, r"mem: seeds must differ, got \[1, 0, 1\]"),
        ({"sweep": {"hyperparameters.gamma": [0.9]}}, "unknown key 'sweep'"),
    ],
)
def test_mistakes_are_named_before_anything_is_trained(data, tmp_path, changes, message):
    with pytest.raises(ValueError, match=message):
        train_seeds(data | changes, "mem", run=tmp_path / "sweep", progress=False)
    assert not (tmp_path / "sweep").exists()


def test_the_first_seed_measures_the_references_for_all(data, tmp_path):
    data["evaluation"] = {"every": 64, "episodes": 1, "references": ["random"]}
    members = expand(data | {"seeds": [4, 5, 6]}, "mem", tmp_path)
    settings = [(one.config.seed, one.config.evaluation.references, one.run.name) for one in members]
    assert settings == [(4, ("random",), "seed_4"), (5, (), "seed_5"), (6, (), "seed_6")]


def test_evolutions_have_several_seeds_as_well(tmp_path, monkeypatch):
    shrink(monkeypatch)
    swept = EVOLUTION | {"generations": 1, "seeds": [3]}
    folder = lidarnaut.train(swept, run=tmp_path / "sweep", progress=False)
    assert read_table(folder / "sweep.csv", "seed", "steps") == [[3, 1]]
    assert all(isinstance(member.config, EvolutionConfig) for member in read_members(folder))
    train_seeds(swept | {"num_workers": 2}, "mem", run=folder, progress=False)
    with pytest.raises(CheckpointError, match=r"seed_3 holds tasks: 1, not 2"):
        train_seeds(swept | {"tasks": 2}, "mem", run=folder, progress=False)

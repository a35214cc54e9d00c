import csv
import json
import shutil
import sys
from pathlib import Path

import pytest

import lidarnaut
from lidarnaut import train_command as train
from lidarnaut.agents import learning
from lidarnaut.agents.config import EvolutionConfig, TrainingConfig, parse_config
from lidarnaut.agents.run_folder import CheckpointError, prepare_folder
from lidarnaut.agents.study import expand, run_study
from lidarnaut.envs.files import read_record
from tests.agents.frontiers.test_evolution import TINY as EVOLUTION
from tests.agents.frontiers.test_evolution import shrink


def read_table(path, *columns):
    with open(path, newline="") as file:
        return [[float(row[name]) for name in columns] for row in csv.DictReader(file)]


BRIEF = {"total_steps": 128, "evaluation": {"every": 128, "episodes": 1, "references": []}}


@pytest.fixture
def data(tiny_data):
    return tiny_data | BRIEF | {"sweep": {"hyperparameters.gamma": [0.9, 0.99]}, "seeds": [0, 1]}


def test_all_combinations_are_trained_and_joined_in_a_table_and_a_picture_per_task(data, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    data["sweep"] |= {"task": {"one": {}, "two": {"environment": {"time_limit": 2.0}}}}
    (tmp_path / "tiny.yaml").write_text(json.dumps(data | {"seeds": [3]}))
    assert train.main(["--config", "tiny.yaml", "--evaluation.every", "64"]) == 0
    (folder,) = (tmp_path / "runs").glob("tiny__sweep__*")
    table = read_table(folder / "sweep.csv", "hyperparameters.gamma", "seed", "steps")
    assert table == [[gamma, 3, 128] for gamma in (0.9, 0.9, 0.99, 0.99)]
    times = read_table(folder / "sweep.csv", "processor_time")
    assert all(0.0 < seconds < 60.0 for (seconds,) in times)
    assert {path.name for path in folder.glob("*.png")} == {"one.png", "two.png"}
    assert (folder / "two.png").read_bytes().startswith(b"\x89PNG")
    assert "gamma 0.99" in capsys.readouterr().out
    trained = []
    monkeypatch.setattr("lidarnaut.agents.learning.run_training", lambda config, **how: trained.append(how["resume"]))
    runs = sorted(path for path in folder.iterdir() if path.is_dir())
    assert train.main(["--resume", str(folder), "--trust", "tests"]) == 0
    assert trained == []
    assert read_table(folder / "sweep.csv", "processor_time") == times
    assert train.main(["--resume", str(folder), "--trust", "tests", "--total-steps", "256"]) == 0
    assert trained == runs


BUGS = """
import os, pathlib, sys
from lidarnaut.agents.networks import ExplorerFeatures

class Unpicklable(Exception):
    def __init__(self, one, two):
        super().__init__("two lines\\nof it")

def reward_fault():
    kind = pathlib.Path("bug").read_text()
    if kind == "kill":
        os.kill(os.getpid(), 9)
    if kind == "exit":
        sys.exit("gone")
    if kind == "odd":
        raise Unpicklable(1, 2)
    if kind == "key":
        raise KeyError("a bug of mine")

class Features(ExplorerFeatures):
    def forward(self, observations):
        reward_fault()
        return super().forward(observations)
"""


FOUND = {
    "key": "KeyError: 'a bug of mine' (traceback: ",
    "exit": "SystemExit: gone (traceback: ",
    "odd": "Unpicklable: two lines of it (traceback: ",
    "kill": "BrokenProcessPool: A process in the process pool was terminated abruptly",
}


def test_a_bug_of_any_kind_fails_one_training_until_it_is_fixed(data, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "bugs", raising=False)
    (tmp_path / "bugs.py").write_text(BUGS)
    own = {"policy_kwargs": {"features_extractor_class": "bugs:Features"}}
    data["sweep"] = {"kind": {"bad": {"hyperparameters": own}, "good": {}}}
    (tmp_path / "tiny.yaml").write_text(json.dumps(data | {"seeds": [0]}))
    command, good = ["--config", "tiny.yaml"], None
    for bug, says in FOUND.items():
        (tmp_path / "bug").write_text(bug)
        assert train.main(command) == 2
        (folder,) = Path("runs").iterdir()
        first, second = capsys.readouterr().err.strip().splitlines()[-2:]
        again = f"--resume {folder} --trust bugs:Features tests.agents.fake_env:Fake-v0"
        assert f"1 of 2 trainings failed; retry with {again}:" in first
        assert second.startswith(f"000_kind=bad__0: {says}")
        assert (folder / "001_kind=good__0" / "checkpoints" / "step_000000128").is_dir()
        kept = folder / "000_kind=bad__0.traceback.txt"
        assert kept.exists() == (bug != "kill")
        if kept.exists():
            assert "bugs.py" in kept.read_text()
        assert len(read_table(folder / "sweep.csv")) == 1
        good = good or (folder / "001_kind=good__0" / "processor_time").read_text()
        jobs = "2" if bug == "odd" else "1"  # the last bug kills its process
        command = ["--resume", str(folder), "--jobs", jobs, "--trust", "bugs", "tests"]
    (tmp_path / "bug").write_text("")
    assert train.main(command) == 0
    assert (folder / "000_kind=bad__0" / "checkpoints" / "step_000000128").is_dir()
    assert (folder / "001_kind=good__0" / "processor_time").read_text() == good
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


def test_a_sweep_goes_on_with_more_trainings_and_with_no_others(data, copies, tmp_path):
    folder, data = tmp_path / "sweep", data | {"seeds": [0]}
    assert lidarnaut.train(data, run=folder, progress=False) == folder
    swept = (folder / "sweep.yaml").read_text()
    for changes, says in (
        ({"sweep": {"hyperparameters.gamma": [0.9, 0.98]}}, "001_gamma=0.99__0 is no longer in the sweep: sweep, ex"),
        ({"seeds": [1]}, "sweep, exclude and seeds may only add trainings"),
        ({"hyperparameters": {"n_steps": 16}}, "hyperparameters.n_steps: 32"),
        ({"seed": 1}, "seed: 'the default', not 1"),
        ({"hyperparameters": {**data["hyperparameters"], "gamma": 0.9}}, "hyperparameters.gamma: .*, not"),
        ({"num_envs": 2}, "num_envs: 4, not 2"),
        ({"environment": {**data["environment"], "world": "caves"}}, "environment.world: .the default., "),
        ({"environment": {"id": data["environment"]["id"]}}, "environment.time_limit: 4.0, not 'the def"),
        ({"total_steps": 64}, "128 of total_steps, more than 64"),
        ({"network": {"hidden": 8}}, "network.hidden: 64, not 8"),
    ):
        with pytest.raises(CheckpointError, match=says):
            run_study(data | changes, "mem", resume=folder, progress=False)
    assert (folder / "sweep.yaml").read_text() == swept
    more = data | {"sweep": {"hyperparameters.gamma": [0.9, 0.99, 0.5]}, "checkpoints": {"every": 128}}
    run_study(more, "mem", resume=folder, progress=False)
    assert read_table(folder / "sweep.csv", "hyperparameters.gamma") == [[0.9], [0.99], [0.5]]
    times = {path: path.read_text() for path in folder.glob("*/processor_time")}
    run_study(more | {"seeds": [0, 1]}, "mem", resume=folder, progress=False)
    rows = [[gamma, seed] for gamma in (0.9, 0.99, 0.5) for seed in (0, 1)]
    assert read_table(folder / "sweep.csv", "hyperparameters.gamma", "seed") == rows
    assert len(list(folder.glob("*/config.yaml"))) == 6
    assert (folder / "sweep.png").exists()
    assert times == {path: path.read_text() for path in times}


def test_a_single_run_does_not_become_a_sweep(data, tiny_run):
    with pytest.raises(ValueError, match="jobs must be at least 1, got 0"):
        run_study(data, "mem", resume=tiny_run, jobs=0, progress=False)
    with pytest.raises(CheckpointError, match="tiny holds a single run: sweep and seeds may not change"):
        run_study(data, "mem", resume=tiny_run, progress=False)
    assert not (tiny_run / "sweep.yaml").exists()


def test_trainings_whose_names_are_alike_keep_their_runs(data, tmp_path):
    data["sweep"] = {"network": {"a" * 90: {"network": {"hidden": 8}}, "a" * 91: {"network": {"hidden": 16}}}}
    first, other = (member.run for member in expand(data | {"seeds": [0]}, "mem", tmp_path))
    assert first != other
    for run in (first, other):
        run.mkdir()
        (run / "config.yaml").touch()
        assert [member.run for member in expand(data | {"seeds": [0]}, "mem", tmp_path)] == [first, other]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sweep": {"hyperparameters.gamma": 0.9}}, "sweep must hold lists of values by keys"),
        ({"sweep": {"evaluation.evry": [1]}}, r"unknown key 'evaluation.evry' \(did you mean 'every'\?\)"),
        ({"sweep": {"experiment.name": [1]}}, "--experiment.name: experiment is 'tiny', not a mapping"),
        ({"exclude": [{"hyperparameters.gamma": [0.8]}]}, r"exclude must hold .*gamma: \[0.8\]; .* has \[0.9, 0.99\]"),
        ({"exclude": [{"algorithm": ["PPO"]}]}, r"exclude must hold .* got algorithm: \['PPO'\]; algorithm has \[\]"),
        ({"sweep": {"hyperparameters": {"gamma": [0.9]}}}, r"hyperparameters: gamma must hold settings, got \[0.9\]"),
        ({"sweep": {"task": {"a": {"totl_steps": 1}}}}, r"unknown key 'totl_steps' \(did you mean 'total_steps'\?\)"),
        ({"seeds": 3}, "seeds must be a list of whole numbers, got 3"),
    ],
)
def test_mistakes_are_named_before_anything_is_trained(data, tmp_path, changes, message):
    with pytest.raises(ValueError, match=message):
        run_study(data | changes, "mem", resume=tmp_path / "sweep", progress=False)
    assert not (tmp_path / "sweep").exists()


def test_tasks_bring_settings_of_their_own_and_some_algorithms_fit_some_of_them(data, tmp_path):
    tasks = {"short": {"environment": {"time_limit": 2.0}}, "long": {"total_steps": 256, "evaluation": {"episodes": 2}}}
    few = {"algorithm": "A2C", "hyperparameters": {"batch_size": 1}, "num_envs": 2}
    data["sweep"] = {"task": tasks, "algorithm": {"PPO": {"algorithm": "PPO"}, "few": few}}
    data["exclude"] = [{"task": ["long"], "algorithm": ["few"]}]
    data["evaluation"] = {"every": 64, "episodes": 1, "references": ["random"]}
    members = expand(data, "mem", tmp_path)
    settings = [(one.group, one.config.algorithm, one.config.total_steps, one.config.seed) for one in members]
    assert settings == [
        *(("short", algorithm, 128, seed) for algorithm in ("PPO", "A2C") for seed in (0, 1)),
        *(("long", "PPO", 256, seed) for seed in (0, 1)),
    ]
    assert [one.config.environment.arguments.get("time_limit") for one in members] == [2.0] * 4 + [4.0] * 2
    assert members[0].config.hyperparameters == {"n_steps": 32, "batch_size": 64, "n_epochs": 2}
    # Only the first training of each task measures the classic policies: all trainings share the episodes.
    assert [bool(one.config.evaluation.references) for one in members] == [True, False, False, False, True, False]


def test_evolutions_are_swept_as_well(tmp_path, monkeypatch):
    shrink(monkeypatch)
    swept = EVOLUTION | {"generations": 1, "sweep": {"sigma": [0.05]}, "seeds": [3]}
    folder = run_study(swept, "mem", resume=tmp_path / "sweep", progress=False)
    assert read_table(folder / "sweep.csv", "sigma", "steps") == [[0.05, 1]]
    assert all(isinstance(member.config, EvolutionConfig) for member in expand(swept, "mem", folder))
    run_study(swept | {"num_workers": 2}, "mem", resume=folder, progress=False)
    with pytest.raises(CheckpointError, match=r"000_sigma=0.05__3 holds tasks: 1, not 2"):
        run_study(swept | {"tasks": 2}, "mem", resume=folder, progress=False)

"""A real Ray cluster of two cores, started in another folder."""

import csv
import json
import os
import re
from pathlib import Path

import pytest

from lidarnaut import evaluate_command as evaluate
from lidarnaut import train_command as train
from lidarnaut.agents.config import EvolutionConfig
from lidarnaut.agents.frontiers.evolution import evolve
from tests.agents.conftest import TINY
from tests.agents.frontiers.test_evolution import TINY as EVOLUTION

ray = pytest.importorskip("ray", reason="needs the extra `ray`: make test-ray")

ROOT = Path(__file__).parents[2]
EXPLORERS = """
import os, pathlib
from lidarnaut.baselines import EXPLORERS
from ray_helper import HERE

class Mine(EXPLORERS["nearest"]):
    def act(self, reading, belief):
        marker = pathlib.Path(os.environ["RAY_TEST_MARKER"])
        if HERE and marker.exists() and marker.read_text() != str(os.getpid()):  # in a worker
            marker.unlink()
            os.kill(os.getpid(), 9)  # once
        return super().act(reading, belief)
"""
FEATURES = """
import torch
from lidarnaut.agents.networks import ExplorerFeatures

class Bad(ExplorerFeatures):
    def forward(self, observations):
        if torch.initial_seed() == 1:
            raise KeyError("a bug of mine")
        return super().forward(observations)
"""


def room(half):
    corners = [[-half, -half], [half, -half], [half, half], [-half, half], [-half, -half]]
    return json.dumps({"source": "mine", "licence": "none", "spawns": [[0.0, 0.0, 0.0]], "polylines": [corners]})


def map_of(width):
    free = b"\x00" + b"\xfe" * (width - 2) + b"\x00"
    return b"P5 %d %d 255\n" % (width, width) + b"\x00" * width + free * (width - 2) + b"\x00" * width


def write_files(folder, half, width, here):
    """Write files of equal names and different contents into the folder of the command and that of the cluster."""
    (folder / "in").mkdir(parents=True)
    (folder / "maps").mkdir()
    (folder / "in" / "room.yaml").write_text(room(half))
    about = {"image": "m.pgm", "resolution": 0.1, "origin": [0.0, 0.0, 0.0], "negate": 0}
    (folder / "maps" / "m.yaml").write_text(json.dumps(about | {"occupied_thresh": 0.65, "free_thresh": 0.196}))
    (folder / "maps" / "m.pgm").write_bytes(map_of(width))
    for name, text in (("ray_explorers", EXPLORERS), ("ray_helper", f"HERE = {here}\n"), ("ray_features", FEATURES)):
        (folder / "in" / f"{name}.py").write_text(text)
    return folder / "in"


@pytest.fixture(scope="module")
def top(tmp_path_factory):
    return tmp_path_factory.mktemp("ray")


@pytest.fixture(scope="module")
def address(top):
    from ray.cluster_utils import Cluster

    there = write_files(top / "there", 3.0, 50, here=False)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(there)
        patch.setenv("RAY_TEST_MARKER", str(top / "marker"))
        patch.setenv("PYTHONPATH", os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")])))
        cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 2, "include_dashboard": False})
    yield cluster.address
    cluster.shutdown()


@pytest.fixture(scope="module")
def here(top):
    return write_files(top / "here", 6.0, 90, here=True)


def rows_of(path):
    """Drop the columns that depend on the clock."""
    with open(path, newline="") as file:
        rows = [
            {k: v for k, v in row.items() if k not in ("decision_ms", "processor_time")} for row in csv.DictReader(file)
        ]
    return sorted(rows, key=str)


def test_an_evaluation_reads_what_the_command_reads_and_outlives_a_worker(address, top, here, monkeypatch, capsys):
    monkeypatch.chdir(here)
    monkeypatch.syspath_prepend(str(here))
    monkeypatch.setenv("RAY_TEST_MARKER", str(top / "marker"))
    command = ["--policies", "nearest", "ray_explorers:Mine", "--worlds", "mine=room.yaml", "map=../maps/m.yaml"]
    command += ["--episodes", "1", "--physics", "kinematic", "--time-limit", "4", "--record"]
    assert evaluate.main([*command, "--out", "a"]) == 0
    (top / "marker").write_text(str(os.getpid()))
    assert evaluate.main([*command, "--out", "b", "--ray", address]) == 0, capsys.readouterr().err
    assert not (top / "marker").exists()
    assert not ray.is_initialized()
    assert len(rows_of("a/episodes.csv")) == 4
    assert rows_of("a/episodes.csv") == rows_of("b/episodes.csv")
    assert {path.name for path in Path("a/episodes").iterdir()} == {path.name for path in Path("b/episodes").iterdir()}


def test_a_sweep_comes_out_where_the_command_says_and_says_what_failed(address, here, monkeypatch, capsys):
    monkeypatch.chdir(here)
    environment = {"world": "room.yaml", "num_workers": 0, "time_limit": 3.0, "observations": ["scan", "motion"]}
    data = TINY | {"environment": environment, "total_steps": 128, "seeds": [0, 1]}
    data["hyperparameters"] = TINY["hyperparameters"] | {
        "policy_kwargs": {"features_extractor_class": "ray_features:Bad"}
    }
    data["evaluation"] = {"every": 128, "episodes": 1, "references": []}
    tables = []
    for more in ([], ["--ray", address]):
        Path("tiny.yaml").write_text(json.dumps(data))
        assert train.main(["--config", "tiny.yaml", *more]) == 2
        said = capsys.readouterr().err
        assert "Traceback" not in said
        assert "\x1b" not in said.splitlines()[-1]
        assert re.search(r"seed_1: KeyError: 'a bug of mine' \(traceback: (.*)\)", said.splitlines()[-1])
        (folder,) = Path("runs").iterdir()
        tables.append(rows_of(folder / "sweep.csv"))
        folder.rename(f"sweep_{len(tables)}")
    assert len(tables[0]) == 1
    assert tables[0] == tables[1]


def test_an_evolution_reaches_the_same_values(address, here, monkeypatch):
    monkeypatch.chdir(here)
    config = EvolutionConfig(**EVOLUTION | {"tasks": 2, "generations": 1})
    runs = [evolve(config, run=Path(f"evolved_{at}"), ray=at, progress=False) for at in (None, address)]
    for name in ("generations.csv", "evaluations.csv"):
        assert (runs[0] / name).read_text() == (runs[1] / name).read_text()

"""Every registered id is trained, killed, resumed, evaluated beside classic policies, recorded and played."""

import csv

import numpy as np
import pytest

import envs.player.__main__ as player
import evaluate
from agents.callbacks import RunCallback
from agents.config import parse_config
from agents.training import train
from envs import ENVIRONMENTS
from envs.ids import arguments_of

CLASSIC = {"Navigate": "pursuit", "Track": "route_follower", "ExploreTeam": "rrt_team"}
"""A classic policy for an id; explorations have `nearest`."""
BEND = [[-2.0, -0.5], [-0.55, -0.55], [-0.55, 0.55], [-2.0, 0.5]]


class Killed(BaseException):
    """Ends a training as a signal does: nothing is saved on the way out."""


def kill_in_second_update(monkeypatch):
    ends = []

    def end(callback):
        ends.append(callback)
        if len(ends) == 2:
            raise Killed

    monkeypatch.setattr(RunCallback, "_on_rollout_end", end)


@pytest.mark.parametrize("id", ENVIRONMENTS)
def test_an_id_goes_through_every_door(id, tmp_path, monkeypatch):
    name, taken = id.removeprefix("lidarnaut/").removesuffix("-v0"), arguments_of(id)
    environment = {"id": id, "num_workers": 0, "time_limit": 2.0}
    if "world_size" in taken and "world" not in ENVIRONMENTS[id][1]:
        environment |= {"world": "pimouse_arena"}
    elif "path" in taken:
        own = {"world": "turtlebot3_world", "robot": "turtlebot3_burger", "path": BEND, "map_resolution": 0.1}
        environment |= own
    network = {"width": 8, "heads": 2} if "Frontiers" in name else {"features": 8, "channels": 2, "hidden": 8}
    data = {
        "experiment": "tiny",
        "environment": environment,
        "algorithm": "PPO",
        "total_steps": 24,
        "num_envs": 2,
        "hyperparameters": {"n_steps": 4, "batch_size": 8},
        "network": network,
        "evaluation": {"episodes": 1, "every": 1000},
        "checkpoints": {"every": 8, "keep": 2},
    }
    config, run = parse_config(data, "tiny"), tmp_path / "run"
    with monkeypatch.context() as patch:
        kill_in_second_update(patch)
        with pytest.raises(Killed):
            train(config, run=run, progress=False)
    train(config, resume=run, progress=False)
    with open(run / "evaluations.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["steps"]) for row in rows] == [0.0, 0.0, 24.0]
    assert np.isfinite([float(row["progress"]) for row in rows]).all()

    policies, out = [CLASSIC.get(name, "nearest"), "random", f"LEARNED=learned:{run}"], tmp_path / "out"
    command = ["--id", id, "--policies", *policies, "--episodes", "1", "--physics", "kinematic", "--record"]
    command += ["--time-limit", "2", "--no-world-sections", "--out", str(out)]
    for key in ("path", "map_resolution"):
        command += ["--arguments." + key, str(environment[key])] if key in environment else []
    if "world" in environment:
        command += ["--worlds", environment["world"]]
    if "robot" in environment:
        command += ["--robot", environment["robot"]]
    assert evaluate.main(command) == 0
    with open(out / "episodes.csv", newline="") as file:
        assert {row["policy"] for row in csv.DictReader(file)} == {*policies[:2], "LEARNED"}
    recordings = sorted((out / "recordings").glob("*.npz"))
    assert len(recordings) == 3
    page = tmp_path / "page.html"
    player.main((recordings[0],), page, open=False)
    assert "<html" in page.read_text()

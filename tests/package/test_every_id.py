"""Every task is trained, killed, resumed, evaluated, recorded and played."""

import csv
from unittest.mock import Mock

import numpy as np
import pytest

import lidarnaut.envs.player.__main__ as player
from lidarnaut import evaluate_command as evaluate
from lidarnaut.agents.callbacks import RunCallback
from lidarnaut.agents.training import train
from lidarnaut.envs import ENVIRONMENTS
from lidarnaut.envs.ids import arguments_of
from tests.agents.tiny import tiny
from tests.test_contract import TASKS

pytestmark = pytest.mark.usefixtures("no_curves", "no_workers", "no_overview")

CLASSIC = {"Navigate": "pursuit", "Dock": "dock", "Sweep": "spiral", "Track": "route_follower"}
CLASSIC |= {"ExploreTeam": "rrt_team"}
"""Classic policy by id; explorations have `nearest`, goals in unknown worlds `pursuit`."""


class Killed(BaseException):
    """Ends a training without saving, like a signal."""


FIRST_IDS = {(entry_point, arguments.get("task")): id for id, (entry_point, arguments) in [*ENVIRONMENTS.items()][::-1]}
"""First id of each task; the other ids of a task differ in arguments."""


@pytest.mark.parametrize("id", [*FIRST_IDS.values(), "lidarnaut/ReachCrowd-v0"])
def test_an_id_goes_through_every_door(id, tmp_path, monkeypatch):
    name, taken = id.removeprefix("lidarnaut/").removesuffix("-v0"), arguments_of(id)
    environment = {"id": id, "num_workers": 0, "time_limit": 2.0}
    if "world_size" in taken and "world" not in ENVIRONMENTS[id][1]:
        environment |= {"world": "pimouse_arena"}
    elif "path" in taken:
        environment |= {key: TASKS["Track"][key] for key in ("world", "robot", "path", "map_resolution")}
    evaluation = {"episodes": 1, "every": 1000, "at_start": True}
    config = tiny("PPO", name, total_steps=24, environment=environment, evaluation=evaluation)
    run = tmp_path / "run"
    with monkeypatch.context() as patch:
        patch.setattr(RunCallback, "_on_rollout_end", Mock(side_effect=[None, Killed]))
        with pytest.raises(Killed):
            train(config, run=run, progress=False)
    train(config, resume=run, progress=False)
    rows = list(csv.DictReader((run / "evaluations.csv").read_text().splitlines()))
    assert [float(row["steps"]) for row in rows[:3]] == [0.0, 0.0, 24.0]
    assert [row["split"] for row in rows] == ["test", "validation", "validation", "test"]
    assert np.isfinite([float(row["progress"]) for row in rows]).all()

    usual = "pursuit" if "Reach" in name else "nearest"
    policies, out = [CLASSIC.get(name, usual), "random", f"LEARNED=learned:{run}"], tmp_path / "out"
    command = ["--id", id, "--policies", *policies, "--episodes", "1", "--physics", "kinematic", "--record"]
    command += ["--time-limit", "2", "--out", str(out)]
    options = {"path": "--arguments.path", "map_resolution": "--arguments.map_resolution", "world": "--worlds"}
    for key, option in {**options, "robot": "--robot"}.items():
        command += [option, str(environment[key])] if key in environment else []
    assert evaluate.main(command) == 0
    rows = csv.DictReader((out / "episodes.csv").read_text().splitlines())
    assert {row["policy"] for row in rows} == {*policies[:2], "LEARNED"}
    recordings = sorted((out / "recordings").glob("*.npz"))
    assert len(recordings) == 3
    page = tmp_path / "page.html"
    player.main((recordings[0],), page, open=False)
    assert "<html" in page.read_text()

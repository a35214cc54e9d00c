import os
import shutil
import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from lidarnaut import train_command as train
from lidarnaut.agents.config import EvolutionConfig
from lidarnaut.agents.curves import read_evaluations
from lidarnaut.agents.frontiers import evolution
from lidarnaut.agents.frontiers.evolution import evolve
from lidarnaut.agents.frontiers.features import NAMES, PRIOR
from lidarnaut.agents.frontiers.rollout import compare
from lidarnaut.agents.frontiers.tasks import HELD_OUT, SIDES, TRAINING_ROBOTS, TRAINING_WORLDS, draw_task, make_world
from lidarnaut.agents.learned import find_policy, load_policy
from lidarnaut.agents.run_folder import GENERATIONS, CheckpointError
from lidarnaut.envs.files import Lock, dump_record
from lidarnaut.envs.robots import ROBOT_NAMES
from lidarnaut.envs.worlds import FAMILIES, WORLD_NAMES, explorable_area

TINY = {"algorithm": "evolution", "experiment": "tiny", "seed": 1, "population": 4, "tasks": 1, "validation_tasks": 1}
TINY |= {"num_workers": 1, "validate_every": 2, "families": ("rooms",)}


def test_half_of_the_library_is_held_out_and_tasks_hold_none_of_it_and_fit_their_robots():
    assert set(HELD_OUT.worlds) < set(WORLD_NAMES)
    assert set(HELD_OUT.robots) < set(ROBOT_NAMES)
    assert len(HELD_OUT.worlds) >= len(WORLD_NAMES) / 2
    assert not set(TRAINING_WORLDS) & set(HELD_OUT.worlds)
    assert not set(TRAINING_ROBOTS) & set(HELD_OUT.robots)
    rng = np.random.default_rng(0)
    tasks = [draw_task(rng) for _ in range(80)]
    names = {task.world for task in tasks}
    assert {*SIDES} < names <= {*SIDES, *TRAINING_WORLDS}
    assert all(task.world_seed % 2 == 0 for task in tasks)
    assert {task.robot.name for task in tasks} <= {*TRAINING_ROBOTS, "drawn"}
    assert min(task.robot.lidar.range_max for task in tasks) < 4.0 < 15.0 < max(t.robot.lidar.range_max for t in tasks)
    for task in tasks[:6]:
        area = explorable_area(make_world(task), task.robot, task.resolution)
        assert area.area > (0.3 * task.size[0] * task.size[1] if task.world in FAMILIES else 8.0)


def test_a_score_that_shuns_gain_takes_longer():
    rng = np.random.default_rng(3)
    tasks = [draw_task(rng, ("rooms",)) for _ in range(3)]
    ratios = np.array([compare(task, [PRIOR, -PRIOR]) for task in tasks])[:, :, 0]
    np.testing.assert_array_equal(ratios[:, 0], 0.0)
    assert ratios[:, 1].mean() > 0.1


WHOLE = EvolutionConfig(**TINY | {"tasks": 2}, generations=3)


def shrink(patch):
    """Explore small rooms in this process."""
    patch.setitem(SIDES, "rooms", (6.0, 7.0))
    patch.setattr("lidarnaut.agents.frontiers.tasks.LEAST_AREA", 2.0)
    patch.setattr("lidarnaut.agents.frontiers.tasks.LIBRARY_SHARE", 0.0)
    patch.setattr(evolution, "make_pool", lambda *_: ThreadPoolExecutor(1))


@pytest.fixture
def small_rooms(monkeypatch):
    shrink(monkeypatch)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    run = tmp_path_factory.mktemp("runs") / "whole"
    with pytest.MonkeyPatch.context() as patch:
        shrink(patch)
        return evolve(WHOLE, run=run, progress=False)


def test_a_run_that_goes_on_ends_as_one_that_was_never_stopped(whole, small_rooms, tmp_path):
    """After a kill in the second generation, the folder has the results of the first generation only."""
    part = shutil.copytree(whole, tmp_path / "part")
    shutil.rmtree(part / "policy")
    for name, lines in ((GENERATIONS, 1), ("evaluations.csv", 3)):
        (part / name).write_text("".join((part / name).read_text().splitlines(keepends=True)[:lines]))
    (part / "learning_curve.png").unlink()
    evolve(WHOLE, resume=part, progress=False)
    for name in (GENERATIONS, "evaluations.csv"):
        assert (part / name).read_text() == (whole / name).read_text()
    first, second = (load_policy(find_policy(run)).score.weights for run in (whole, part))
    np.testing.assert_array_equal(first, second)
    assert len(first) == len(NAMES)
    assert (part / "learning_curve.png").read_bytes().startswith(b"\x89PNG")


def test_ctrl_c_names_the_run_which_the_command_line_continues(small_rooms, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    config = tmp_path / "tiny.yaml"
    config.write_text(dump_record(EvolutionConfig(**TINY, generations=100)))

    is_over = threading.Event()

    def interrupt():
        while not list(tmp_path.glob(f"runs/*/{GENERATIONS}")):
            time.sleep(0.05)
        os.kill(os.getpid(), signal.SIGINT)
        while not is_over.wait(10.0):  # Python drops an interrupt that arrives in a callback of a weak reference
            os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt, daemon=True)
    thread.start()
    assert train.main(["--config", str(config)]) == 130
    is_over.set()
    thread.join()
    (run,) = Path("runs").iterdir()
    generations = len((run / GENERATIONS).read_text().splitlines())
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert said.partition(": ")[2] == f"stopped after generation {generations}; resume with --resume {run}"
    more = ["--resume", str(run), "--generations"]
    assert train.main([*more, str(generations + 1)]) == 0
    assert len((run / GENERATIONS).read_text().splitlines()) == generations + 1
    assert (run / "policy" / "policy.json").exists()
    with Lock(run):
        assert train.main([*more, "99"]) == 2
    assert f"{run} is in use: process" in capsys.readouterr().err


def test_validations_begin_with_nearest_which_is_measured_once(whole, small_rooms, tmp_path, monkeypatch):
    nearest, first, *later = rows = read_evaluations(whole)
    assert [(row["policy"], row["steps"]) for row in (nearest, first)] == [("nearest", 0), ("learned", 0)]
    assert [(row["policy"], row["steps"]) for row in later] == [("learned", 2), ("learned", 3)]
    assert first["time_over_rule"] == first["time_over_rule_q25"] == 1.0  # the rule against itself
    assert nearest["time_over_rule"] != 1.0
    assert all(row["time_over_rule"] > 0.0 and 0.0 < row["progress"] <= 1.0 for row in rows)
    monkeypatch.setattr(evolution, "compare", None)
    again = shutil.copytree(whole, tmp_path / "again")
    evolve(WHOLE, resume=again, progress=False)
    assert read_evaluations(again) == rows


def test_mistakes_and_missing_runs_are_named(tmp_path, capsys):
    config = tmp_path / "tiny.yaml"
    for line, says in (("population: 2", "population"), ("families: [rooms, mase]", "unknown family 'mase'")):
        config.write_text(f"algorithm: evolution\nexperiment: tiny\n{line}\n")
        assert train.main(["--config", str(config)]) == 2
        assert says in capsys.readouterr().err
    with pytest.raises(CheckpointError, match="not a run folder"):
        evolve(EvolutionConfig(**TINY), resume=tmp_path, progress=False)
    with pytest.raises(CheckpointError, match="pretrained/nothing"):
        find_policy("pretrained/nothing")

"""The robustness benchmark at a tiny size, and that it would see what it looks for."""

import os

import numpy as np
import pytest

from benchmarks.robustness import inputs, maps
from benchmarks.robustness.__main__ import main
from benchmarks.robustness.damage import damage_array, damage_bytes, damage_tree
from benchmarks.robustness.drives import crosses, drive, slide, take_steps
from benchmarks.robustness.inputs import outcome_of, try_inputs
from benchmarks.robustness.kinds import KINDS
from benchmarks.robustness.maps import MAPS, reset_once, write_map
from benchmarks.robustness.repeats import digest
from envs.geometry import Pose2D
from envs.worlds import load_map

FEW = {"worlds": 12, "robots": 12, "maps": 12, "configurations": 12, "logs": 25, "bags": 20, "checkpoints": 6}


@pytest.mark.parametrize("kind", FEW)
def test_damaged_inputs_are_refused_by_name_or_work(kind, tmp_path):
    outcomes = []
    for number in range(FEW[kind]):
        folder = tmp_path / kind / str(number)
        folder.mkdir(parents=True)
        outcomes.append(outcome_of(kind, number, 1, folder))
    assert [said for outcome, said in outcomes if outcome == "failed"] == []
    assert "refused" in {outcome for outcome, _ in outcomes}


def test_damage_depends_on_the_generator_alone_and_leaves_the_original():
    tree = {"a": [1.0, {"b": 2}], "c": "text"}
    for damage, valid in ((damage_tree, tree), (damage_bytes, b"0123456789"), (damage_array, np.ones((3, 2)))):
        before = repr(valid)
        results = [[repr(damage(valid, np.random.default_rng(k))) for k in range(50)] for _ in range(2)]
        assert results[0] == results[1]
        assert len(set(results[0])) > 10
        assert repr(valid) == before


def stumble(folder, name, rng):
    raise KeyError(name)


def say_nothing(folder, name, rng):
    raise ValueError("something is wrong")


@pytest.mark.parametrize(("use", "says"), [(stumble, "KeyError"), (say_nothing, "no name in ValueError")])
def test_what_is_no_clear_error_counts_as_failed(use, says, monkeypatch, tmp_path):
    monkeypatch.setitem(KINDS, "maps", use)
    outcome, said = outcome_of("maps", 0, 0, tmp_path)
    assert outcome == "failed"
    assert says in said


def hang(pipe, folder):
    while pipe.recv():
        pass


def die(pipe, folder):
    os._exit(3)


@pytest.mark.parametrize(("serve", "says"), [(hang, "took longer than 1 s"), (die, "exit code 3")])
def test_inputs_that_hang_or_kill_are_counted_and_the_next_one_runs(serve, says, monkeypatch):
    monkeypatch.setattr(inputs, "serve", serve)
    monkeypatch.setattr(inputs, "START_LIMIT", 30 if serve is die else 1)
    monkeypatch.setattr(inputs, "PATIENCE", 1)
    (row,), failures = try_inputs(("maps",), 2, 0, progress=False)
    assert row == {"damaged": "maps", "tried": 2, "refused with a clear error": 0, "accepted": 0, "failed": 2}
    assert all(says in failure for failure in failures)


def compute_for_ever(pipe, folder):
    inputs.limit_time(1)
    while True:
        pass


def test_inputs_that_compute_for_ever_are_ended(monkeypatch):
    monkeypatch.setattr(inputs, "serve", compute_for_ever)
    _, failures = try_inputs(("maps",), 1, 0, progress=False)
    assert failures == ["maps, input 0: took longer than 120 s"]


def test_a_long_run_is_measured():
    (row,), _ = take_steps(1280, 0, ("truth",))
    assert row["steps"] == 1280
    assert 50 < row["memory in the second quarter [MiB]"] < 8000
    assert row["in the last quarter [MiB]"] > 50


def test_a_step_through_a_wall_is_seen():
    wall = np.array([[1.0, -1.0, 1.0, 1.0]])
    assert crosses(Pose2D(0.5, 0.0, 0.0), Pose2D(1.5, 0.2, 0.0), wall)
    assert not crosses(Pose2D(0.5, 0.0, 0.0), Pose2D(0.9, 0.2, 0.0), wall)
    assert not crosses(Pose2D(0.5, 1.5, 0.0), Pose2D(1.5, 1.6, 0.0), wall)
    assert not crosses(Pose2D(0.5, 0.0, 0.0), Pose2D(0.5, 0.0, 0.0), wall)


def test_walls_hold():
    done = drive("turtlebot3_world", "kinematic", 200, 0)
    assert done["control periods"] == 200
    assert done["in contact"] > 10
    assert (done["through a wall"], done["above the speed"]) == (0, 0)


def test_robots_slide_along_walls():
    assert slide("turtlebot3_burger", "kinematic", 60) == pytest.approx(0.22 * 10.0 * 0.5, rel=0.1)
    assert slide("turtlebot3_burger", "bullet", 15) == pytest.approx(0.22 * 10.0, rel=0.1)


def test_episodes_repeat_after_others_and_differ_between_seeds():
    case = "Explore-v0, hector"
    assert digest(case, 3, 20) == digest(case, 3, 20, after=1) != digest(case, 4, 20)


def test_the_command_prints_the_tables_of_the_stages_that_are_named(capsys):
    assert main(("walls", "slides"), worlds=("turtlebot3_dqn_stage1",), physics=("kinematic",), wall_steps=20) == 0
    said = capsys.readouterr().out
    assert "| physics | worlds | control periods | in contact | through a wall | above the speed |" in said
    assert "| kinematic | 1 | 20 |" in said
    assert "| along a wall [m]: kinematic | 15 deg |" in said


@pytest.mark.parametrize("name", MAPS)
def test_hard_maps_are_driven_on_or_refused_by_name(name, tmp_path):
    path = write_map(name, 240, tmp_path)
    data = load_map(path).data
    assert data.shape == (240, 240)
    assert 0.005 < np.mean(data == 0) < 0.99
    _, walls, refused, _ = reset_once(str(path), "Explore-v0, kinematic, truth")
    assert (walls > 0) == (name != "maze, corridors -1")
    assert ("does not fit" in refused) == (name == "maze, corridors -1")


def test_large_maps_are_reset_in_other_processes_and_what_takes_too_long_fails(monkeypatch, capsys):
    for case in list(maps.CASES)[1:]:
        monkeypatch.delitem(maps.CASES, case)
    for name in list(MAPS)[:-1]:
        monkeypatch.delitem(maps.MAPS, name)
    monkeypatch.setattr(maps, "MOST_TIME", 0.0)
    assert main(("maps",), map_size=120) == 1
    said = capsys.readouterr().out
    assert "| one wall | 8 |" in said
    assert "failed: one wall, Explore-v0, kinematic, truth: " in said

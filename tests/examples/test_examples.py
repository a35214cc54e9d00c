import ast
import csv
import importlib
import os
import re
import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

from lidarnaut.evaluate_command import main as evaluate

EXAMPLES = Path(__file__).parents[2] / "examples"
PATHS = sorted(EXAMPLES.glob("*.py"))
NEEDS = {"pettingzoo_team": "pettingzoo", "run_onnx": "onnxruntime", "torchrl_ppo": "torchrl", "rllib_ppo": "ray.rllib"}
NEEDS["optuna_search"] = "optuna"
TINY = """
experiment: tiny
recipe: null
algorithm: PPO
total_steps: 8
num_envs: 2
environment: {id: lidarnaut/ReachGoal-v0, world: hall, world_size: [6, 6], time_limit: 1, num_workers: 0}
hyperparameters: {n_steps: 4, batch_size: 4}
evaluation: {episodes: 1}
"""


@pytest.fixture
def load(monkeypatch):
    """Import an example by name in its folder; skip the test if a requirement is missing."""
    monkeypatch.chdir(EXAMPLES)
    monkeypatch.syspath_prepend(str(EXAMPLES))

    def load_example(name):
        if name in NEEDS:
            pytest.importorskip(NEEDS[name], reason=f"{NEEDS[name]} is not installed", exc_type=ImportError)
        return importlib.import_module(name)

    yield load_example
    for path in PATHS:
        sys.modules.pop(path.stem, None)


def test_every_example_has_a_test():
    text = Path(__file__).read_text()
    assert [path.stem for path in PATHS if f'"{path.stem}"' not in text] == []


@pytest.mark.parametrize("path", PATHS, ids=lambda path: path.stem)
def test_examples_are_short_and_need_no_arguments(path):
    text = path.read_text()
    assert 20 <= len(text.splitlines()) <= 80
    functions = [node for node in ast.parse(text).body if isinstance(node, ast.FunctionDef)]
    (main,) = (function for function in functions if function.name == "main")
    assert len(main.args.defaults) == len(main.args.args)


def test_the_quick_start_films_the_pretrained_explorer(load, tmp_path):
    film = tmp_path / "film.gif"
    assert load("quick_start").main(seconds=5.0, film=film) > 0.05
    assert film.stat().st_size > 10_000


def test_the_code_of_the_readme_learns_and_explores(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    learn, explore = re.findall(r"```python\n(.*?)```", (EXAMPLES.parent / "README.md").read_text(), re.DOTALL)
    names = {}
    exec(learn.replace("50_000", "2_048"), names)
    assert (tmp_path / "explorer.zip").exists()
    exec(explore.replace('"human"', "None"), names)
    assert re.search(r"explored (99|100) % in \d+ s", capsys.readouterr().out)


@pytest.mark.parametrize("algorithm", ["PPO", "RecurrentPPO", "MaskablePPO"])
def test_policies_are_trained_saved_and_tried(load, algorithm, tmp_path):
    small = {"total_timesteps": 64, "num_envs": 4, "num_steps": 16, "seconds": 3.0, "num_tests": 1}
    explored = load("sb3_ppo").main(algorithm, **small, out=tmp_path / "policy")
    assert 0.0 < explored <= 1.0
    assert (tmp_path / "policy.zip").exists()


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_the_loop_of_cleanrl_learns_in_both_autoreset_modes(load, mode):
    means = load("cleanrl_ppo").main(total_timesteps=512, num_envs=4, num_steps=64, mode=mode, seconds=5.0)
    assert len(means) == 2
    assert np.isfinite(means).all()


OWN_SHAPES = {"motion": (6,), "sectors": (8,)}


@pytest.mark.parametrize(
    ("name", "arguments", "is_right"),
    [
        ("torchrl_ppo", {"total_timesteps": 128, "batch_size": 64}, np.isfinite),
        ("rllib_ppo", {"total_timesteps": 128, "batch_size": 64}, np.isfinite),
        ("pettingzoo_team", {"steps": 20, "num_robots": 2}, lambda rewards: len(set(rewards.values())) == 1),
        ("own_map", {"seconds": 60.0}, lambda explored: explored > 0.5),
        ("own_robot", {"seconds": 20.0}, lambda explored: explored > 0.3),
        ("own_slam", {"seconds": 20.0}, lambda errors: errors["forgetful"] > 2.0 * errors["hector"]),
        ("own_reward", {"steps": 30}, lambda rewards: rewards["careful"] > 0.0),
        ("own_algorithm", {"total_steps": 256, "episodes": 1}, lambda policy: policy.id == "lidarnaut/ReachGoal-v0"),
        ("own_observation", {"steps": 20}, lambda seen: {name: seen[name].shape for name in seen} == OWN_SHAPES),
    ],
)
def test_an_example_gives_what_it_says(load, name, arguments, is_right, tmp_path):
    if name == "own_algorithm":
        arguments = {**arguments, "out": tmp_path / "run"}
    assert is_right(load(name).main(**arguments))


def test_a_sensor_of_ones_own_measures_distances_with_noise(load):
    module = load("own_sensor")
    measured = module.main(steps=20)
    assert measured.shape == (21, 3)
    assert ((measured > 0.2) & (measured < 8.0)).all()
    np.testing.assert_array_equal(measured, module.main(steps=20))


def test_a_task_of_ones_own_is_an_environment_like_the_others(load):
    assert load("own_task").main(seconds=10.0)["geodesic_distance"] < 4.3
    arguments = {"world_size": (8.0, 8.0), "physics": "kinematic"}
    env = gymnasium.make("own_task/ReachGoal-v0", **arguments)
    check_env(env.unwrapped, skip_render_check=True)
    env.close()
    vector = gymnasium.make_vec("own_task/ReachGoal-v0", 2, num_workers=0, **arguments)
    vector.reset(seed=0)
    assert vector.step(np.zeros((2, 2), dtype=np.float32))[4]["geodesic_distance"].shape == (2,)
    vector.close()


def test_explorers_of_ones_own_explore_and_enter_the_arena(load, tmp_path):
    fractions = load("own_explorer").main(seconds=12.0)
    assert fractions["largest"] > fractions["circling"]
    policies = [f"own_explorer:{name}" for name in ("largest", "Circling", "ahead", "Chooser")]
    options = ["--worlds", "pimouse_arena", "--episodes", "1", "--physics", "kinematic", "--time-limit", "6"]
    assert evaluate(["--policies", *policies, *options, "--out", str(tmp_path)]) == 0
    with open(tmp_path / "episodes.csv", newline="") as file:
        lengths = {row["policy"]: float(row["path_length"]) for row in csv.DictReader(file)}
    assert list(lengths) == policies
    assert min(lengths.values()) > 0.2


def test_a_search_resumes_trials_part_by_part_and_prunes_those_that_fall_behind(load, tmp_path, monkeypatch):
    search = load("optuna_search")
    (tmp_path / "tiny.yaml").write_text(TINY)
    values = iter([0.5] * 8 + [0.1])  # of four trials in two parts, and of the first part of another one
    monkeypatch.setattr(search, "headline_of_rows", lambda rows: rows[-1].update(mine=next(values)) or "mine")
    study = search.main(str(tmp_path / "tiny.yaml"), trials=5, steps=16, parts=2, out=tmp_path / "runs")
    assert [trial.state.name for trial in study.trials] == ["COMPLETE"] * 4 + ["PRUNED"]
    assert [len(list(run.glob("checkpoints/step_*"))) for run in sorted((tmp_path / "runs").iterdir())] == [3] * 4 + [2]


def test_a_bag_is_recorded_converted_and_replayed(load, tmp_path):
    conflicts = load("replay_bag").main(out=tmp_path, seconds=6.0)
    assert set(conflicts) == {"hector", "tinyslam"}
    assert max(conflicts.values()) < 0.05
    assert (tmp_path / "hector" / "summary.json").exists()


def test_a_policy_in_onnx_drives_without_torch(load, tmp_path):
    load("run_onnx")
    pytest.importorskip("onnx", reason="onnx is not installed")
    code = "import run_onnx, sys; info = run_onnx.main(run_onnx.Path(sys.argv[1]), 6.0); "
    code += "print(info['explored_fraction'], 'torch' in sys.modules)"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-c", code, str(tmp_path / "twist.onnx")]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    first, (explored, has_torch) = done.stdout.splitlines()[-2], done.stdout.splitlines()[-1].split()
    assert first.startswith("turtlebot3_burger: ")
    assert float(explored) > 0.1
    assert has_torch == "False"

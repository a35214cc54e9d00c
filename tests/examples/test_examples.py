"""Every example runs, on a small budget, and gives what its text says."""

import ast
import importlib.util
import re
from pathlib import Path

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

EXAMPLES = Path(__file__).parents[2] / "examples"
SMALL = {"total_timesteps": 128, "num_envs": 4, "num_steps": 32}


def load(name):
    """Return an example as a module; it is skipped where what it needs is not installed."""
    needs = {"maskable_ppo": "sb3_contrib", "recurrent_ppo": "sb3_contrib", "pettingzoo_team": "pettingzoo"}
    needs |= {"torchrl_ppo": "torchrl", "rllib_ppo": "ray.rllib"}
    if name in needs:
        pytest.importorskip(needs[name], reason=f"{needs[name]} is not installed", exc_type=ImportError)
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_example_has_a_test():
    text = Path(__file__).read_text()
    assert [path.stem for path in EXAMPLES.glob("*.py") if f'"{path.stem}"' not in text] == []


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem)
def test_examples_are_short(path):
    assert 20 <= len(path.read_text().splitlines()) <= 80


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem)
def test_examples_need_no_arguments(path):
    functions = [node for node in ast.parse(path.read_text()).body if isinstance(node, ast.FunctionDef)]
    (main,) = (function for function in functions if function.name == "main")
    assert len(main.args.defaults) == len(main.args.args)


def test_the_quick_start_films_the_pretrained_explorer(tmp_path):
    film = tmp_path / "film.gif"
    assert load("quick_start").main(seconds=5.0, film=film) > 0.05
    assert film.stat().st_size > 10_000


def test_the_quick_start_of_the_readme_explores(capsys):
    (code,) = re.findall(r"```python\n(.*?)```", (EXAMPLES.parent / "README.md").read_text(), re.DOTALL)
    exec(code.replace('"human"', "None"), {})
    assert re.search(r"explored (99|100) % in \d+ s", capsys.readouterr().out)


@pytest.mark.parametrize("name", ["sb3_ppo", "maskable_ppo", "recurrent_ppo"])
def test_policies_are_trained_saved_and_tried(name, tmp_path):
    explored = load(name).main(**SMALL, out=tmp_path / "policy", seconds=6.0)
    assert 0.0 < explored <= 1.0
    assert (tmp_path / "policy.zip").exists()


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_the_loop_of_cleanrl_learns_in_both_autoreset_modes(mode):
    means = load("cleanrl_ppo").main(total_timesteps=512, num_envs=4, num_steps=64, mode=mode, seconds=5.0)
    assert len(means) == 2
    assert np.isfinite(means).all()


@pytest.mark.parametrize("name", ["torchrl_ppo", "rllib_ppo"])
def test_other_libraries_train(name):
    assert np.isfinite(load(name).main(total_timesteps=128, batch_size=64))


def test_the_team_steps_by_agents():
    rewards = load("pettingzoo_team").main(steps=20, num_robots=2)
    assert len(set(rewards.values())) == 1


def test_a_world_drawn_with_numpy_is_explored():
    assert load("own_map").main(seconds=60.0) > 0.5


def test_a_robot_of_ones_own_explores():
    assert load("own_robot").main(seconds=20.0) > 0.3


def test_a_sensor_of_ones_own_measures_distances_with_noise():
    module = load("own_sensor")
    measured = module.main(steps=20)
    assert measured.shape == (21, 3)
    assert ((measured > 0.2) & (measured < 8.0)).all()
    np.testing.assert_array_equal(measured, module.main(steps=20))


def test_a_task_of_ones_own_is_driven(monkeypatch):
    monkeypatch.chdir(EXAMPLES)
    info = load("own_task").main(seconds=10.0)
    assert info["geodesic_distance"] < 4.3


def test_explorers_of_ones_own_explore():
    fractions = load("own_explorer").main(seconds=12.0)
    assert fractions["largest"] > fractions["circling"]


def test_a_slam_of_ones_own_drifts():
    errors = load("own_slam").main(seconds=20.0)
    assert errors["forgetful"] > 2.0 * errors["hector"]


def test_a_reward_of_ones_own_counts():
    sums = load("own_reward").main(steps=30)
    assert sums["careful"] > 0.0


def test_an_observation_of_ones_own_is_seen():
    observation = load("own_observation").main(steps=20)
    assert set(observation) == {"motion", "sectors"}


def test_a_robot_localizes_on_its_map_and_drives(tmp_path):
    assert load("localize_and_drive").main(out=tmp_path) == "reached"
    assert (tmp_path / "map.pgm").exists()


def test_a_bag_is_recorded_converted_and_replayed(tmp_path):
    conflicts = load("replay_bag").main(out=tmp_path, seconds=6.0)
    assert set(conflicts) == {"hector", "tinyslam"}
    assert max(conflicts.values()) < 0.05
    assert (tmp_path / "hector" / "summary.json").exists()


def test_each_episode_has_wheels_of_its_own():
    module = load("domain_randomization")
    rows = module.main(episodes=2, seconds=5.0)
    low, high = module.RANGES["drive.wheel_radius"]
    assert low <= rows[:, 0].min() < rows[:, 0].max() <= high
    assert (rows[:, 1] < 0.5).all()

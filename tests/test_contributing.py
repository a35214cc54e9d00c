"""The examples of CONTRIBUTING.md and of the documentation do what their text says."""

import csv
import re
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import envs  # noqa: F401  (registers the environments)
from evaluate import main

ROOT = Path(__file__).parents[1]
QUICK = {"world": "rooms", "world_size": (8.0, 8.0), "physics": "kinematic"}


@pytest.fixture(scope="module")
def own_package(tmp_path_factory):
    """A folder with the modules of CONTRIBUTING.md, in which users would work."""
    folder = tmp_path_factory.mktemp("own")
    text = (ROOT / "CONTRIBUTING.md").read_text()
    blocks = re.findall(r"```python\n# (my_package/\w+\.py)\n(.*?)```", text, re.DOTALL)
    for name, code in blocks:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(code)
    patch = pytest.MonkeyPatch()
    patch.chdir(folder)
    patch.syspath_prepend(str(folder))
    yield folder
    patch.undo()
    for name in [name for name in sys.modules if name.split(".")[0] == "my_package"]:
        del sys.modules[name]


def step_on(env, steps=20):
    """Drive at random and return the last info."""
    env.reset(seed=1)
    env.action_space.seed(1)
    for _ in range(steps):
        observation, _, terminated, truncated, info = env.step(env.action_space.sample())
        assert env.observation_space.contains(observation)
        if terminated or truncated:
            env.reset()
    return info


def test_rules_explorers_and_policies_enter_the_arena(own_package):
    names = ["rules:largest", "explorers:Circling", "policies:ahead", "policies:Chooser"]
    policies = [f"my_package.{name}" for name in names]
    options = ["--worlds", "pimouse_arena", "--episodes", "1", "--physics", "kinematic", "--time-limit", "6"]
    assert main(["--policies", *policies, *options, "--out", str(own_package / "out"), "--no-world-sections"]) == 0
    with open(own_package / "out" / "episodes.csv", newline="") as file:
        lengths = {row["policy"]: float(row["path_length"]) for row in csv.DictReader(file)}
    assert list(lengths) == policies
    assert min(lengths.values()) > 0.2


def test_a_slam_and_a_reward_of_ones_own_are_taken(own_package):
    from my_package.rewards import CAREFUL

    env = gymnasium.make("lidarnaut/Explore-v0", slam="my_package.slams:forgetful", reward=CAREFUL, **QUICK)
    env.reset(seed=0)
    for _ in range(20):
        info = env.step(np.array([0.0, 1.0], dtype=np.float32))[4]
    assert "careful" in info["rewards"]
    assert info["pose_error"][1] == pytest.approx(0.02 * 2.0 * env.unwrapped.robot.max_w, rel=0.4)
    env.close()


def test_an_observation_part_of_ones_own_is_seen(own_package):
    env = gymnasium.make(
        "lidarnaut/Explore-v0", observations={"scan": None, "sectors": "my_package.parts:Sectors"}, **QUICK
    )
    observation, _ = env.reset(seed=0)
    assert set(observation) == {"scan", "sectors"}
    assert observation["sectors"].shape == (8,)
    assert observation["sectors"][0] == pytest.approx(observation["scan"][:45].min(), abs=1e-6)
    step_on(env)
    env.close()


def test_a_task_of_ones_own_is_an_environment_like_the_others(own_package):
    env = gymnasium.make("my_package.escape:my_package/Escape-v0", target=0.5)
    check_env(env.unwrapped, skip_render_check=True)
    env.reset(seed=0)
    total = 0.0
    for _ in range(300):
        _, reward, terminated, truncated, info = env.step(np.array([1.0, 0.1], dtype=np.float32))
        total += reward
        if terminated or truncated:
            break
    assert info["end_reason"] in ("escaped", "time_limit")
    assert total == pytest.approx(info["away"] - 0.02 * info["time"])
    env.close()

    vector = gymnasium.make_vec("my_package/Escape-v0", 2, num_workers=0)
    vector.reset(seed=0)
    assert vector.step(np.zeros((2, 2), dtype=np.float32))[4]["away"].shape == (2,)
    vector.close()

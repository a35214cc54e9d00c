"""The wheel by itself: built, installed into an environment of its own, and used where no checkout is."""

import os
import shutil
import site
import subprocess
import sys
import sysconfig
import tomllib
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(os.name == "nt", reason="environments have other folders on Windows")
ROOT = Path(__file__).parents[1]
SOURCES = ("pyproject.toml", "README.md", "LICENSE", "lidarnaut")
PACKAGES = ("lidarnaut", "lidarnaut/envs", "lidarnaut/baselines", "lidarnaut/agents", "lidarnaut/benchmarks")

EPISODES = """
import gymnasium, lidarnaut
from pathlib import Path
from lidarnaut import agents, baselines, benchmarks, envs, evaluate, train
from lidarnaut.envs.worlds import load_world
from lidarnaut.agents.learned import find_policy, load_policy
from lidarnaut.baselines.episode import begin_episode, decide_with, run

print(lidarnaut.__version__)
for module in (agents, baselines, benchmarks, envs, evaluate, lidarnaut, train):
    print(Path(module.__file__))
print(lidarnaut.find_configuration("explore_frontiers"))
assert load_world("barn:12").goals
for explorer in (baselines.make_explorer("nearest"), load_policy(find_policy("pretrained/frontiers"))):
    env = gymnasium.make("lidarnaut:lidarnaut/ExploreHouse-v0", physics="kinematic", time_limit=3.0)
    start = begin_episode(env, explorer, 0, env.np_random)
    print(run(env, decide_with(explorer, env.unwrapped), *start).info["end_reason"])
"""


def build_wheel(folder):
    """Return a wheel that is built from a copy of the sources, so that the checkout stays as it is."""
    source = folder / "source"
    source.mkdir()
    for name in SOURCES:
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        copy(ROOT / name, source / name)
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*command, "--wheel-dir", str(folder), str(source)], check=True, cwd=folder)
    shutil.rmtree(source)
    (wheel,) = folder.glob("*.whl")
    return wheel


@pytest.fixture(scope="module")
def environment(tmp_path_factory):
    """Return an environment that holds the wheel, and sees the dependencies that this one has."""
    folder = tmp_path_factory.mktemp("wheel")
    wheel = build_wheel(folder)
    environment = folder / "environment"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(environment)], check=True)
    pip = [sys.executable, "-m", "pip", "--python", str(environment / "bin" / "python")]
    install = ["install", "--quiet", "--no-deps", "--no-index", "--no-compile", str(wheel)]
    subprocess.run([*pip, *install], check=True, cwd=folder)
    installed = Path(sysconfig.get_path("purelib", vars={"base": str(environment)}))
    # Folders that a .pth file adds have no .pth files of their own run: an editable checkout stays out of sight.
    (installed / "dependencies.pth").write_text("\n".join(site.getsitepackages()))
    return environment, installed


def run_in(environment, cwd, *command):
    """Run a command of an environment elsewhere, and return what it prints."""
    variables = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    name, *options = command
    done = subprocess.run(
        [str(environment / "bin" / name), *options], cwd=cwd, env=variables, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_wheel_holds_all_that_episodes_need(environment, tmp_path):
    home, installed = environment
    (tmp_path / "episodes.py").write_text(EPISODES)
    for name in ("envs", "agents", "baselines", "benchmarks"):  # folders of a user, which must clash with nothing
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").touch()
    version, *paths, first, second = run_in(home, tmp_path, "python", "episodes.py").split()
    with open(ROOT / "pyproject.toml", "rb") as file:
        assert version == tomllib.load(file)["project"]["version"]
    assert len(paths) == 8
    assert all(Path(path).is_relative_to(installed) for path in paths), paths
    assert (first, second) == ("time_limit", "time_limit")
    assert all((installed / package / "py.typed").exists() for package in PACKAGES)


def test_the_wheel_brings_commands_and_the_configurations_that_they_name(environment, tmp_path):
    home, _ = environment
    for command, option in {
        ("lidarnaut-train", "--config", "explore_frontiers"): "--generations",
        ("lidarnaut-evaluate", "--config", "arena"): "--policies",
        ("lidarnaut-replay",): "--preset",
        ("lidarnaut-teleop",): "--robot",
    }.items():
        said = run_in(home, tmp_path, *command, "--help")
        assert f"usage: {command[0]} " in said
        assert option in said

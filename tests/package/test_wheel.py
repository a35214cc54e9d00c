import email
import os
import re
import shutil
import site
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(os.name == "nt", reason="environments have other folders on Windows")
ROOT = Path(__file__).parents[2]
SOURCES = ("pyproject.toml", "PYPI.md", "MANIFEST.in", "LICENSE", "lidarnaut")
PACKAGES = ("lidarnaut", "lidarnaut/envs", "lidarnaut/baselines", "lidarnaut/agents", "lidarnaut/benchmarks")

EPISODES = """
import gymnasium, lidarnaut
from pathlib import Path
from lidarnaut import agents, baselines, benchmarks, envs, evaluate_command, train_command
from lidarnaut.agents.config import find_configuration
from lidarnaut.envs.worlds import load_world
from lidarnaut.agents.learned import find_policy, load_policy
from lidarnaut.baselines.episode import begin_episode, decide_with, run

print(lidarnaut.__version__)
for module in (agents, baselines, benchmarks, envs, evaluate_command, lidarnaut, train_command):
    print(Path(module.__file__))
print(find_configuration("explore_frontiers", "experiment"))
assert load_world("barn:12").goals
for explorer in (lidarnaut.make_policy("nearest"), load_policy(find_policy("pretrained/frontiers"))):
    env = gymnasium.make("lidarnaut:lidarnaut/ExploreHouse-v0", physics="kinematic", time_limit=3.0)
    start = begin_episode(env, explorer, 0, env.np_random)
    print(run(env, decide_with(explorer, env.unwrapped), *start).info["end_reason"])
"""


BUILD_SDIST = "import sys; from setuptools.build_meta import build_sdist; build_sdist(sys.argv[1])"


def build_wheel(folder):
    """Return a wheel, built from an sdist of a copy of the sources, which leaves the checkout unchanged."""
    source = folder / "source"
    source.mkdir()
    for name in SOURCES:
        copy = shutil.copytree if (ROOT / name).is_dir() else shutil.copy
        copy(ROOT / name, source / name)
    subprocess.run([sys.executable, "-c", BUILD_SDIST, str(folder)], check=True, cwd=source, stdout=subprocess.DEVNULL)
    shutil.rmtree(source)
    (sdist,) = folder.glob("*.tar.gz")
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*command, "--wheel-dir", str(folder), str(sdist)], check=True, cwd=folder)
    (wheel,) = folder.glob("*.whl")
    return wheel


@pytest.fixture(scope="module")
def environment(tmp_path_factory):
    """Return an environment with the wheel and access to the current dependencies."""
    folder = tmp_path_factory.mktemp("wheel")
    wheel = build_wheel(folder)
    environment = folder / "environment"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(environment)], check=True)
    pip = [sys.executable, "-m", "pip", "--python", str(environment / "bin" / "python")]
    install = ["install", "--quiet", "--no-deps", "--no-index", "--no-compile", str(wheel)]
    subprocess.run([*pip, *install], check=True, cwd=folder, env=without_checkout())
    installed = Path(sysconfig.get_path("purelib", vars={"base": str(environment)}))
    # Folders added by a .pth file have no .pth files run: an editable checkout stays hidden.
    (installed / "dependencies.pth").write_text("\n".join(site.getsitepackages()))
    return environment, installed


def without_checkout():
    """Return the variables of this process without PYTHONPATH, which may name a checkout."""
    return {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}


def run_in(environment, cwd, *command):
    line = [environment / "bin" / command[0], *command[1:]]
    done = subprocess.run(line, cwd=cwd, env=without_checkout(), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_wheel_holds_all_that_episodes_need(environment, tmp_path):
    home, installed = environment
    (tmp_path / "episodes.py").write_text(EPISODES)
    for name in ("envs", "agents", "baselines", "benchmarks"):  # folders of a user, which must not clash
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").touch()
    version, *paths, first, second = run_in(home, tmp_path, "python", "episodes.py").split()
    with open(ROOT / "pyproject.toml", "rb") as file:
        assert version == tomllib.load(file)["project"]["version"]
    assert len(paths) == 8
    assert all(Path(path).is_relative_to(installed) for path in paths), paths
    assert (first, second) == ("time_limit", "time_limit")
    assert all((installed / package / "py.typed").exists() for package in PACKAGES)


def test_sdist_and_wheel_hold_all_modules_and_data_and_no_tests(environment):
    home, installed = environment
    (sdist,) = home.parent.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        packed = {name.partition("/")[2] for name in archive.getnames()}
    assert not [name for name in packed if name.startswith("tests")]
    assert {"LICENSE", "PYPI.md", "pyproject.toml"} <= packed
    folders = [ROOT / name for name in ("envs", "baselines", "agents", "benchmarks", "configs")]
    paths = [path for folder in folders for path in folder.rglob("*") if path.is_file() and path.suffix != ".pyc"]
    expected = {f"lidarnaut/{path.relative_to(ROOT).as_posix()}" for path in paths}
    assert expected - packed == set()
    assert {name for name in expected if not (installed / name).is_file()} == set()
    # The description leads to nothing that is not there.
    (metadata,) = installed.glob("lidarnaut-*.dist-info/METADATA")
    said = email.message_from_string(metadata.read_text(encoding="utf-8"))
    assert (metadata.parent / "licenses" / "LICENSE").is_file()
    assert said["Description-Content-Type"] == "text/markdown"
    description = said.get_payload()
    assert len(description) > 3000
    assert [link for link in re.findall(r"\]\(([^)]*)\)", description) if not link.startswith("https://")] == []
    assert "pip install" in description


@pytest.mark.parametrize(
    ("line", "status"), [("lidarnaut-evaluate --nonsense 1 2>&1 | true", 2), ("lidarnaut-train --help >&-", 0)]
)
def test_commands_whose_output_nobody_reads_end_quietly_with_their_usual_status(line, status, environment, tmp_path):
    home, _ = environment
    variables = {**without_checkout(), "PATH": f"{home / 'bin'}:{os.environ['PATH']}"}
    bash = ["bash", "-c", f"{line}; exit ${{PIPESTATUS[0]}}"]
    done = subprocess.run(bash, cwd=tmp_path, env=variables, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (status, "")
    assert "Traceback" not in done.stdout


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

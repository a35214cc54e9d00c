import ast
import importlib
import re
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS = PROJECT["optional-dependencies"]
LINUX = {"sys_platform": "linux", "platform_machine": "x86_64"}
PYBULLETS = {"pybullet", "pybullet-arm64"}
PEERS = {(name, "step.py") for name in ("irsim", "jax", "jaxmarl", "navground", "vmas")}
"""Imports of `benchmarks/speed/peers` in virtual environments of their own."""


def required(dependencies, **environment):
    found = [Requirement(one) for one in dependencies]
    return {canonicalize_name(r.name): r for r in found if r.marker is None or r.marker.evaluate(environment)}


def test_every_imported_library_is_declared():
    distributions = packages_distributions()
    declared = {name for needed in (PROJECT["dependencies"], *EXTRAS.values()) for name in required(needed)} | PYBULLETS
    folders = ("envs", "baselines", "agents", "benchmarks")
    paths = [ROOT / "train.py", ROOT / "evaluate.py", *(path for one in folders for path in (ROOT / one).rglob("*.py"))]
    undeclared = set()
    for path in paths:
        for node in ast.walk(ast.parse(path.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module] if isinstance(node, ast.ImportFrom) and node.module and not node.level else []
            for name in {name.partition(".")[0] for name in names} - {"lidarnaut", *sys.stdlib_module_names}:
                owners = {canonicalize_name(owner) for owner in distributions.get(name, [name])}
                undeclared |= set() if owners & declared else {(name, path.name)}
    assert undeclared == PEERS


@pytest.mark.parametrize(
    ("version", "machine", "needs"),
    [
        ("3.11", LINUX, {"pybullet"}),
        ("3.12", LINUX, {"pybullet-arm64"}),
        ("3.13", LINUX, {"pybullet-arm64"}),
        ("3.13", {"sys_platform": "win32", "platform_machine": "AMD64"}, {"pybullet-arm64"}),
        ("3.13", {"sys_platform": "darwin", "platform_machine": "arm64"}, {"pybullet-arm64"}),
        ("3.14", LINUX, set()),
        ("3.13", {"sys_platform": "darwin", "platform_machine": "x86_64"}, set()),
        ("3.11", {"sys_platform": "win32", "platform_machine": "AMD64"}, set()),
        ("3.13", {"sys_platform": "linux", "platform_machine": "aarch64"}, set()),
    ],
)
def test_pybullet_is_required_where_it_has_wheels(version, machine, needs):
    assert required(PROJECT["dependencies"], python_version=version, **machine).keys() & PYBULLETS == needs


def test_extras_that_texts_name_exist():
    patterns = "*.md", "docs/**/*.md", "*.py", "*/*.py", "envs/**/*.py"
    paths = [path for pattern in patterns for path in ROOT.glob(pattern)]
    texts = "".join(path.read_text(encoding="utf-8") for path in paths if not path.is_relative_to(ROOT / ".venv"))
    named = set(",".join(re.findall(r"(?:lidarnaut|[\"'`]\.)\[([a-z,]+)\]", texts)).split(","))
    assert {"contrib", "export", "pettingzoo"} <= named <= set(EXTRAS)


def test_a_missing_pettingzoo_is_named_with_its_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "pettingzoo", None)
    monkeypatch.delitem(sys.modules, "lidarnaut.envs.wrappers.pettingzoo", raising=False)
    with pytest.raises(ImportError, match=r"pip install 'lidarnaut\[pettingzoo\]'"):
        importlib.import_module("lidarnaut.envs.wrappers.pettingzoo")


def test_the_versions_that_are_tested_with_satisfy_the_requirements():
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pins = dict(line.split("==") for line in lines if not line.startswith("#"))
    versions = {canonicalize_name(name): version for name, version in pins.items()}
    for needed in (PROJECT["dependencies"], EXTRAS["dev"], EXTRAS["docs"]):
        requirements = map(Requirement, needed)
        wrong = [r for r in requirements if not r.specifier.contains(versions[canonicalize_name(r.name)])]
        assert wrong == []


def test_classifiers_name_the_pythons_that_run_the_tests():
    named = {line.rpartition(" ")[2] for line in PROJECT["classifiers"] if re.search(r":: 3\.\d+$", line)}
    assert PROJECT["requires-python"].removeprefix(">=") == min(named, key=lambda version: int(version[2:]))
    assert set(re.findall(r"python(3\.\d+)", (ROOT / "Makefile").read_text())) <= named


def test_continuous_integration_runs_what_developers_run():
    (path,) = (ROOT / ".github" / "workflows").iterdir()
    workflow = yaml.load(path.read_text(), yaml.BaseLoader)  # `on` is a key, not True
    steps = {name: job["steps"] for name, job in workflow["jobs"].items()}
    assert "pull_request" in workflow["on"]
    assert [step["run"] for step in steps["tests"] if "run" in step] == ["make check", ".ci/run"]
    makefile = (ROOT / "Makefile").read_text()
    assert steps["newer-python"][-1]["run"].replace("make", "$(MAKE)", 1) in makefile
    set_up = [step["with"] for some in steps.values() for step in some if "setup-python" in step.get("uses", "")]
    assert {step["python-version"] for step in set_up} == set(re.findall(r"python(3\.\d+)", makefile))


def test_forms_of_issues_ask_distinct_questions():
    for name in ("bug", "feature"):
        form = yaml.safe_load((ROOT / ".github" / "ISSUE_TEMPLATE" / f"{name}.yml").read_text())
        assert {"name", "description", "body"} <= form.keys()
        questions = [(question["id"], question["attributes"]["label"]) for question in form["body"]]
        assert len(set(questions)) == len(questions) >= 3


def test_commits_are_checked_by_the_ruff_of_the_project():
    (repository,) = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())["repos"]
    assert f"ruff=={repository['rev'].removeprefix('v')}" in (ROOT / "constraints.txt").read_text().splitlines()
    assert {hook["id"] for hook in repository["hooks"]} == {"ruff-check", "ruff-format"}

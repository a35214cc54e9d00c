"""Control periods have one entrance, and one order of stages, which a page states."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "concepts" / "architecture.md").read_text(encoding="utf-8")
SECTION = PAGE.partition("## One control period")[2].partition("\n## ")[0]
STAGE_CALLS = {"move", "update_robots", "step_rows", "step_robots", "locate", "slow_down", "measure_all", "on_period"}
ENTRANCES = {"run", "advance", "command", "drive"}
TREES = {
    path: ast.parse((ROOT / path).read_text(encoding="utf-8"))
    for folder in ("envs", "driver", "baselines", "agents", "benchmarks")
    for path in sorted(one.relative_to(ROOT).as_posix() for one in (ROOT / folder).rglob("*.py"))
}


def calls(node):
    """Return the names of called functions and methods in the order of the source."""
    found = [one for one in ast.walk(node) if isinstance(one, ast.Call)]
    found.sort(key=lambda one: (one.lineno, one.col_offset))
    return [getattr(one.func, "attr", getattr(one.func, "id", "")) for one in found]


def methods(path):
    return {
        (kind.name, one.name): one
        for kind in TREES[path].body
        if isinstance(kind, ast.ClassDef)
        for one in kind.body
        if isinstance(one, ast.FunctionDef)
    }


def test_the_page_names_the_stages_in_the_order_of_the_code():
    page = [name for name in re.findall(r"^\| \d \| `(\w+)` \|", SECTION, re.MULTILINE)]
    own, order = methods("envs/period.py"), []

    def follow(name):
        for called in calls(own["Period", name]):
            if called in page:
                order.append(called)
            elif called in ("advance", "finish"):
                follow(called)

    follow("run")
    assert page == order
    assert len(page) == 6


def test_the_page_names_all_callers():
    rows = re.findall(r"^\| (`[^|]+) \| (`[^|]+) \| [^|]+ \|$", SECTION, re.MULTILINE)
    page = set()
    for callers, called in rows:
        page |= set(zip(re.findall(r"`([\w.]+)`", callers), re.findall(r"`(\w+)`", called), strict=True))
    found = set()
    for path in TREES:
        for (kind, name), node in methods(path).items():
            for one in ast.walk(node):
                if not (
                    isinstance(one, ast.Call) and isinstance(one.func, ast.Attribute) and one.func.attr in ENTRANCES
                ):
                    continue
                owner = ast.unparse(one.func.value)
                if owner.rpartition(".")[2] == "period" or (kind == "Batch" and owner == "self"):
                    found.add((f"{kind}.{name}", one.func.attr))
    assert page == found


@pytest.mark.parametrize(
    "path", [path for path in TREES if path.startswith(("envs/core", "envs/vector", "envs/decisions"))]
)
def test_stages_are_called_by_the_period_alone(path):
    called = set(calls(TREES[path]))
    assert not called & (STAGE_CALLS - {"measure_all"}) - ({"on_period"} if path == "envs/core.py" else set())

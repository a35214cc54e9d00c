"""Generated parts of pages, committed with the pages: `python docs/_ext/page_parts.py` writes all of them anew.

A part stands between the lines `<!-- generated: KIND NAME -->` and `<!-- end -->`. Builds of the site write them, too.
"""

import ast
import contextlib
import importlib
import io
import re
import sys
from pathlib import Path
from typing import Any

import environment_pages
import gallery
import gymnasium
import numpy as np
import robot_keys

from lidarnaut.agents.frontiers.score import PRETRAINED
from lidarnaut.agents.learned import load_policy
from lidarnaut.agents.run_folder import CheckpointError
from lidarnaut.baselines.adoption import needed_arguments
from lidarnaut.baselines.policy import ObservationPolicy
from lidarnaut.envs import ENVIRONMENTS
from lidarnaut.envs.localization import PRESETS, AmclParams
from lidarnaut.envs.simulation import Crowd
from lidarnaut.envs.worlds import load_world

DOCS = Path(__file__).parents[1]
EXAMPLES = DOCS.parent / "examples"
PAGES = DOCS / "reference/environments"
"""Folder of pages that are generated as a whole."""
PART = re.compile(r"(<!-- generated: (\w+) ?(\S*) -->\n).*?(<!-- end -->)", re.DOTALL)
LANGUAGES = {".py": "python", ".yaml": "yaml"}
POLICIES = ("frontiers", "foresight", "twist", "reach", "crowd")
"""Pretrained policies in the order of the table."""
EXPLORE = "lidarnaut/Explore"


def source(path: str) -> str:
    """Return a file of the project as a code block."""
    return f"```{LANGUAGES[Path(path).suffix]}\n{(DOCS.parent / path).read_text(encoding='utf-8').rstrip()}\n```"


def printed(example: str) -> str:
    """Return the output of an example, with its default budget, as a code block."""
    with contextlib.redirect_stdout(io.StringIO()) as output:
        _load(example).main()
    return f"```text\n{output.getvalue().rstrip()}\n```"


def examples() -> str:
    """Return a section for each example: its docstring, and a link to the file."""
    paths = sorted(EXAMPLES.glob("*.py"), key=lambda path: (path.stem != "quick_start", path))
    texts = {path.name: ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) for path in paths}
    return "\n\n".join(f"## `{name}`\n\n{text}\n\n[Source](../../../examples/{name})" for name, text in texts.items())


def card(name: str) -> str:
    """Return the model card of a pretrained policy as a section."""
    return "#" + (PRETRAINED / name / "README.md").read_text(encoding="utf-8")


def policies() -> str:
    """Return a table of the tasks that each pretrained policy can do, by the observations in its record."""
    ids: dict[str, list[str]] = {}
    for id, (entry_point, arguments) in ENVIRONMENTS.items():
        ids.setdefault(arguments.get("task", entry_point), []).append(id)
    loaded = [load_policy(f"pretrained/{name}") for name in POLICIES]
    rows = [
        [", ".join(f"`{id.partition('/')[2]}`" for id in group), *(suits(one, group) for one in loaded)]
        for group in ids.values()
    ]
    return _table(["ids", *(f"`{name}`" for name in POLICIES)], rows)


def suits(policy: Any, ids: list[str]) -> str:
    """Return whether a policy was trained for a task, or gets its observations there; explorers only explore."""
    trained = policy.id if isinstance(policy, ObservationPolicy) else EXPLORE
    is_possible = trained.startswith(EXPLORE) == ids[0].startswith(EXPLORE)
    for id in ids if is_possible and trained != EXPLORE else ():
        try:
            env = gymnasium.make(id, physics="kinematic", disable_env_checker=True, **needed_arguments(policy))
            policy(env.observation_space.sample())
        except (ValueError, CheckpointError):  # another part, or another shape
            is_possible = False
    return "trained" if trained in ids else "yes" if is_possible else "no"


def amcl_presets() -> str:
    """Return a table of the parameters in which the presets of AMCL differ."""
    rows = [[name, *(getattr(one, name) for one in PRESETS.values())] for name in AmclParams.__dataclass_fields__]
    return _table(["parameter", *PRESETS], [[f"`{name}`", *values] for name, *values in rows if len(set(values)) > 1])


def crowd() -> str:
    """Return a table of the parameters of a crowd."""
    values = {name: getattr(Crowd(), name) for name in Crowd.__slots__}
    for name in ("forces", "orca"):
        values[name] = ", ".join(f"`{key}` {value}" for key, value in values[name]._asdict().items())
    rows = [[f"`{name}`", values[name], " ".join(text.split())] for name, text in Crowd.__slots__.items()]
    return _table(["parameter", "default", "meaning"], rows)


def _table(head: list[str], rows: list[list[Any]]) -> str:
    return "\n".join(f"| {' | '.join(map(str, row))} |" for row in (head, ["---"] * len(head), *rows))


def _load(example: str) -> Any:
    sys.path.insert(0, str(EXAMPLES))
    try:
        return importlib.import_module(example)
    finally:
        sys.path.remove(str(EXAMPLES))


KINDS: dict[str, Any] = {
    **{make.__name__: make for make in (source, printed, examples, card, policies, amcl_presets, crowd)},
    "robot_keys": robot_keys.tables,
    "quantities": environment_pages.quantities,
}
"""Functions that return the text of a part, by kind; the name after the kind is their argument."""


def filled(text: str, *, without: tuple[str, ...] = ()) -> str:
    """Return the text of a page with its parts written anew, except those of some kinds."""

    def write(part: re.Match[str]) -> str:
        start, kind, name, end = part.groups()
        return part[0] if kind in without else f"{start}\n{KINDS[kind](*filter(None, [name])).strip()}\n\n{end}"

    return PART.sub(write, text)


def write_pages() -> None:
    """Write the parts of all pages, and the pages of environments. Unchanged pages keep their modification time."""
    PAGES.mkdir(exist_ok=True)
    before = {path: path.read_text(encoding="utf-8") for path in DOCS.rglob("*.md")}
    after = {PAGES / name: text for name, text in environment_pages.pages(DOCS).items()}
    for path in set(PAGES.glob("*.md")) - set(after):
        path.unlink()
    after |= {path: filled(text) for path, text in before.items() if PART.search(text)}
    for path, text in after.items():
        if before.get(path) != text:
            path.write_text(text, encoding="utf-8")


def draw_pictures() -> None:
    """Draw the worlds and the robot of the examples."""
    world, robot = _load("own_map").draw_world(np.random.default_rng(0)), _load("own_robot").ROBOT
    figures = {"own_map": gallery.draw_world(world), "own_robot": gallery.draw_robot(robot)}
    figures["workshop"] = gallery.draw_world(load_world(EXAMPLES / "workshop.yaml"))
    for name, figure in figures.items():
        figure.savefig(DOCS / f"images/{name}.png", dpi=gallery.DPI)


if __name__ == "__main__":
    write_pages()
    draw_pictures()

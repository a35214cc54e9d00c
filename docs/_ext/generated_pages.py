"""Generate pages during the build of the site: environments, galleries of worlds and robots, examples, an episode.

Sources are the registry, docstrings, libraries and examples, so that pages agree with the code. Output folders are
`docs/reference/environments/`, `docs/reference/gallery/` and `docs/start/examples/`, which git ignores, and the site.
"""

import ast
import contextlib
import importlib
import inspect
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
from sphinx.application import Sphinx

from lidarnaut.agents.policy_names import parse_policy
from lidarnaut.baselines.episode import run_episode
from lidarnaut.envs.player import EpisodeRecorder, build_page
from lidarnaut.envs.worlds import load_world

INCLUDED = {"CONTRIBUTING.md": "reference/contributing.md", "CHANGELOG.md": "reference/changelog.md"}
PRETRAINED = "frontiers", "twist", "crowd", "reach"
INCLUDED |= {f"agents/pretrained/{name}/README.md": "guides/pretrained.md" for name in PRETRAINED}
"""Markdown files outside docs, and the pages that include them."""

PRINTED = ("map", "robot", "sensor", "reward", "observation", "slam", "explorer", "task")
"""Examples `own_NAME.py` whose output is shown on pages; they take seconds."""
EPISODE = "episode.html"
"""Page of an episode, relative to the site."""
EXAMPLES = """\
# Examples

Each example is a file in `examples/`. Run it with `.venv/bin/python examples/NAME.py`; `--help` lists its arguments.
Tests run all examples with small budgets.
"""
EXAMPLE = """
## `{name}`

{text}

:::{{dropdown}} Source
```{{literalinclude}} ../../../examples/{name}
:language: python
```
:::
"""


_written: list[str] = []
"""Last docstring converted by `to_rst`."""


def example_page(folder: Path) -> str:
    """Return the page of the examples in a folder: docstring and source of each."""
    docstrings = {path.name: ast.get_docstring(ast.parse(path.read_text())) for path in sorted(folder.glob("*.py"))}
    names = sorted(docstrings, key=lambda name: name != "quick_start.py")
    return EXAMPLES + "".join(EXAMPLE.format(name=name, text=docstrings[name]) for name in names)


def run_examples(folder: Path, out: Path) -> None:
    """Write the output of the examples in `PRINTED`, and pictures and tables for the pages about them."""
    sys.path.insert(0, str(folder))
    for name in (f"own_{part}" for part in PRINTED):
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            importlib.import_module(name).main()
        (out / f"{name}.txt").write_text(printed.getvalue(), encoding="utf-8")
    world = sys.modules["own_map"].draw_world(np.random.default_rng(0))
    gallery.draw_world(world).savefig(out / "own_map.png", dpi=gallery.DPI)
    page = (out.parents[1] / "guides/world_files.md").read_text()
    (text,) = re.findall(r"^```yaml\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    (file := out / "world_file.yaml").write_text(text, encoding="utf-8")
    gallery.draw_world(load_world(str(file))).savefig(out / "world_file.png", dpi=gallery.DPI)
    (out / "robot_keys.txt").write_text(robot_keys.tables(), encoding="utf-8")
    (out / "quantities.txt").write_text(environment_pages.quantities(), encoding="utf-8")
    gallery.draw_robot(sys.modules["own_robot"].ROBOT).savefig(out / "own_robot.png", dpi=gallery.DPI)
    sys.path.remove(str(folder))


def write_pages(app: Sphinx) -> None:
    """Write all generated pages below the source folder; unchanged pages keep their modification time."""
    source = Path(app.srcdir)
    for folder, pages in (
        (source / "reference/environments", environment_pages.pages(source)),
        (source / "reference/gallery", gallery.pages(source / "reference/gallery")),
        (source / "start/examples", {"index.md": example_page(source.parent / "examples")}),
    ):
        folder.mkdir(exist_ok=True)
        for stale in set(folder.glob("*.md")) - {folder / name for name in pages}:
            stale.unlink()
        for name, text in pages.items():
            path = folder / name
            if not path.exists() or path.read_text(encoding="utf-8") != text:
                path.write_text(text, encoding="utf-8")
    run_examples(source.parent / "examples", source / "start/examples")


def record_episode(app: Sphinx) -> None:
    """Write the page of an episode, shown in frames: the pretrained explorer in a house outside its training."""
    if app.builder.format != "html":
        return
    env = gymnasium.make("lidarnaut/ExploreHouse-v0", physics="kinematic")
    explorer = parse_policy("pursuit:pretrained/frontiers").make(env.action_space)
    with EpisodeRecorder(env, explorer) as recorder:
        run_episode(env, explorer, seed=0)
    page = build_page([recorder.recording({"explorer": "pursuit:pretrained/frontiers"})])
    env.close()
    app.outdir.mkdir(parents=True, exist_ok=True)
    (app.outdir / EPISODE).write_text(page, encoding="utf-8")


def link_within(app: Sphinx, name: str, source: list[str]) -> None:
    """Redirect links to files outside docs to the pages that include them."""
    for path, page in INCLUDED.items():
        up = "../" * (name.count("/") + 1)
        source[0] = source[0].replace(f"]({up}{path}", f"](/{page}")


def to_rst(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Convert Markdown in docstrings to reStructuredText.

    Docstrings of environments have their own Markdown pages; only their first line is kept.
    """
    if what == "class" and "## Description" in (inspect.getdoc(obj) or ""):
        lines[1:] = ["", "See its page under Environments for spaces, rewards, episode ends and arguments."]
    lines[:] = [re.sub(r"^#+ (.+)", r"**\1**\n", line) for line in lines]
    text = re.sub(r"(?<!`)`([^`]+)`(?!`)", r"``\1``", "\n".join(lines))
    lines[:] = re.sub(r"\|(\w+)\|", r"\|\1\|", text).split("\n")
    _written[:] = lines


def keep_attributes(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Restore docstrings of attributes: napoleon reads text before a colon in the first line as a type."""
    if what in ("attribute", "data", "property"):
        lines[:] = _written


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the extension."""
    app.connect("builder-inited", write_pages)
    app.connect("builder-inited", record_episode)
    # Before napoleon, which would split single backticks at a colon within.
    app.connect("autodoc-process-docstring", to_rst, priority=100)
    app.connect("autodoc-process-docstring", keep_attributes, priority=900)
    app.connect("source-read", link_within)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

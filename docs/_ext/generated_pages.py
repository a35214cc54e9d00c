"""Generate pages during the build of the site: parts of pages, galleries of worlds and robots, an episode.

The galleries are in `docs/reference/gallery/`, which git ignores. Other generated text is committed: see `page_parts`.
"""

import inspect
import re
from pathlib import Path
from typing import Any

import gallery
import gymnasium
import page_parts
from sphinx.application import Sphinx

from lidarnaut.agents.policy_names import parse_policy
from lidarnaut.baselines.episode import run_episode
from lidarnaut.envs.player import EpisodeRecorder, build_page

EPISODE = "episode.html"
"""Page of an episode, relative to the site."""


_written: list[str] = []
"""Last docstring converted by `to_rst`."""


def write_pages(app: Sphinx) -> None:
    """Write the generated parts of pages, and the galleries; unchanged pages keep their modification time."""
    page_parts.write_pages()
    folder = Path(app.srcdir) / "reference/gallery"
    for name, text in gallery.pages(folder).items():
        if not (path := folder / name).exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


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
    return {"parallel_read_safe": True, "parallel_write_safe": True}

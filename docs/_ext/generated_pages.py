"""Pages that are made when the site is built: environments, galleries of worlds and robots, and examples.

They come from the registry, docstrings, libraries and sources, so that they cannot differ from the code. They are
written to `docs/environments/`, `docs/gallery/` and `docs/examples/`, which git ignores.
"""

import ast
import inspect
import re
from pathlib import Path
from typing import Any

import environment_pages
import gallery
from sphinx.application import Sphinx

INCLUDED = {
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "agents/pretrained/frontiers/README.md": "pretrained.md",
    "agents/pretrained/twist/README.md": "pretrained.md",
    "agents/pretrained/crowd/README.md": "pretrained.md",
}
"""Markdown files outside of docs, and the pages that include them."""

EXAMPLES = """\
# Examples

Each is a file in `examples/` that runs by itself, `.venv/bin/python examples/NAME.py`, and in a test on a small budget.
`--help` tells its arguments.
"""
EXAMPLE = """
## `{name}`

{text}

:::{{dropdown}} Source
```{{literalinclude}} ../../examples/{name}
:language: python
```
:::
"""


def example_page(folder: Path) -> str:
    """Return the page of the examples in a folder, each with its first lines and its source."""
    docstrings = {path.name: ast.get_docstring(ast.parse(path.read_text())) for path in sorted(folder.glob("*.py"))}
    names = sorted(docstrings, key=lambda name: name != "quick_start.py")
    return EXAMPLES + "".join(EXAMPLE.format(name=name, text=docstrings[name]) for name in names)


def write_pages(app: Sphinx) -> None:
    """Write all generated pages below the source folder; pages that have not changed keep their time."""
    source = Path(app.srcdir)
    for folder, pages in (
        (source / "environments", environment_pages.pages(source)),
        (source / "gallery", gallery.pages(source / "gallery")),
        (source / "examples", {"index.md": example_page(source.parent / "examples")}),
    ):
        folder.mkdir(exist_ok=True)
        for stale in set(folder.glob("*.md")) - {folder / name for name in pages}:
            stale.unlink()
        for name, text in pages.items():
            path = folder / name
            if not path.exists() or path.read_text(encoding="utf-8") != text:
                path.write_text(text, encoding="utf-8")


def link_within(app: Sphinx, name: str, source: list[str]) -> None:
    """Let links to files that GitHub shows outside of docs lead to the pages that include them."""
    for path, page in INCLUDED.items():
        source[0] = source[0].replace(f"](../{path}", f"]({page}")


def to_rst(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Turn what docstrings have of Markdown into reStructuredText.

    Docstrings of environments are Markdown altogether and have pages of their own: their first line is kept.
    """
    if what == "class" and "## Description" in (inspect.getdoc(obj) or ""):
        lines[1:] = ["", "Its page among the environments documents spaces, rewards, ends and arguments."]
    text = re.sub(r"(?<!`)`([^`]+)`(?!`)", r"``\1``", "\n".join(lines))
    lines[:] = re.sub(r"\|(\w+)\|", r"\|\1\|", text).split("\n")


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the extension."""
    app.connect("builder-inited", write_pages)
    # Before napoleon, which would split single backticks at a colon within.
    app.connect("autodoc-process-docstring", to_rst, priority=100)
    app.connect("source-read", link_within)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

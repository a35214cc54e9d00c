"""Layout of the site: sections of the sidebar that fold, and a link to the notebook on each tutorial."""

import re
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx

NOTEBOOKS = "start/tutorials/"
"""Prefix of the names of pages that are notebooks."""
FIRST = "Get started"
"""Section that is unfolded on pages of no section, such as the home page."""
SECTION = re.compile(
    r'<p class="caption"[^>]*><span class="caption-text">(?P<title>.*?)</span></p>\s*(?P<list><ul.*?</ul>)\s*(?=<p |$)',
    re.DOTALL,
)
"""Caption of a section in the navigation of furo, and its list."""


def fold_sections(app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: Any) -> None:
    """Fold all sections of the sidebar except the one of the open page."""
    tree = context.get("furo_navigation_tree", "")
    is_in_section = re.search(r'<ul class="current', tree)

    def folded(found: re.Match[str]) -> str:
        is_open = found["list"].startswith('<ul class="current') or (not is_in_section and found["title"] == FIRST)
        head = f'<summary class="caption"><span class="caption-text">{found["title"]}</span></summary>'
        return f"<details{' open' if is_open else ''}>{head}{found['list']}</details>"

    context["furo_navigation_tree"] = SECTION.sub(folded, tree)


def add_download(app: Sphinx, doctree: nodes.document) -> None:
    """Insert a link to the notebook file below the title of a tutorial."""
    name = app.env.docname
    if name.startswith(NOTEBOOKS) and app.env.doc2path(name).suffix == ".ipynb":
        target = f"{name.removeprefix(NOTEBOOKS)}.ipynb"
        link = addnodes.download_reference(
            "", "", nodes.inline("", f"Download this notebook ({target})"), reftarget=target
        )
        title = next(doctree.findall(nodes.title))
        title.parent.insert(title.parent.index(title) + 1, nodes.paragraph("", "", link, classes=["notebook-download"]))


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the extension."""
    app.connect("html-page-context", fold_sections, priority=900)  # after furo, which makes the tree
    app.connect("doctree-read", add_download, priority=100)  # before Sphinx collects the files to download
    return {"parallel_read_safe": True, "parallel_write_safe": True}

"""Pages of the documentation that are made of registry, docstrings and sources."""

import re
import sys
from pathlib import Path

import gymnasium
import pytest

import envs  # noqa: F401  (registers the environments)

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def pages():
    """The pages of the environments by file name."""
    sys.path.insert(0, str(DOCS / "_ext"))
    import environment_pages

    yield environment_pages.pages(DOCS)
    sys.path.remove(str(DOCS / "_ext"))


def test_every_id_is_on_the_page_of_its_class(pages):
    for spec in gymnasium.registry.values():
        if spec.namespace == "lidarnaut":
            (name,) = re.findall(rf"\| \[`{spec.id}`\]\(([\w.]+)\)", pages["index.md"])
            assert f"`{spec.id}`" in pages[name] or f'make("{spec.id}"' in pages[name]


def test_pages_show_picture_spaces_and_docstring(pages):
    for name in set(pages) - {"index.md"}:
        (picture, *_) = re.findall(r"!\[[^\]]*\]\(\.\./(\S+)\)", pages[name])
        assert (DOCS / picture).stat().st_size < 500_000, name
        for part in ("**action space**", "**observation space**", "## Rewards", "## Episode End", "## Arguments"):
            assert part in pages[name], (name, part)


def test_the_page_of_examples_shows_all_of_them():
    sys.path.insert(0, str(DOCS / "_ext"))
    import example_pages

    sys.path.remove(str(DOCS / "_ext"))
    page = example_pages.page(DOCS.parent / "examples")
    assert page.count("{literalinclude}") == len(list(DOCS.parent.glob("examples/*.py")))

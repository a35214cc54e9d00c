"""Number of words of the manual: `python -m tests.manual` prints it by page.

The manual is all Markdown pages of docs except results, lab notes, and generated text. A word has a letter; code blocks
and targets of links do not count.
"""

import re
import sys
from pathlib import Path

DOCS = Path(__file__).parents[1] / "docs"
LEFT_OUT = (
    "notes.md",
    "results/",
    "reference/api/",
    "reference/environments/",
    "reference/gallery/",
    "reference/formats",
)
NOT_PROSE = re.compile(
    r"<!-- generated: .*?<!-- end -->|^(?P<fence>`{3,}|~{3,}).*?^(?P=fence)|(?<=\])\([^)]*\)", re.DOTALL | re.MULTILINE
)


def words(text: str) -> int:
    """Return the number of words of a page."""
    return sum(any(map(str.isalpha, word)) for word in NOT_PROSE.sub("", text).split())


def words_by_page() -> dict[str, int]:
    """Return the number of words of each page of the manual, by its path in docs."""
    names = sorted(path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md"))
    return {name: words((DOCS / name).read_text("utf-8")) for name in names if not name.startswith(LEFT_OUT)}


if __name__ == "__main__":
    pages = words_by_page()
    sys.stdout.write("".join(f"{number:7,} {name}\n" for name, number in pages.items()) + f"{sum(pages.values()):7,}\n")

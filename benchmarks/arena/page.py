"""A page of text, tables and pictures that becomes Markdown as well as HTML; tables also go to the terminal."""

import base64
import html
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import rich.table
from rich import box
from rich.text import Text

from benchmarks.arena.measures import texts
from benchmarks.arena.statistics import Estimate
from benchmarks.arena.theme import Picture
from envs.files import write_file
from envs.measures import Measure

MAX_OPEN_LINES = 10
"""Tables with more lines are folded away."""


@dataclass(frozen=True, slots=True)
class Cell:
    """A cell of a table."""

    text: str
    note: str = ""
    """In small print: an interval."""
    is_best: bool = False
    link: str = ""
    """Where the text leads, relative to the report; Markdown and terminal leave it out."""

    @classmethod
    def of(cls, value: Estimate, measure: Measure, is_best: bool = False, sign: str = "") -> "Cell":
        """Show an estimate with its interval; `sign="+"` shows it as a difference."""
        return cls(*texts(measure, value, sign), is_best)


@dataclass(frozen=True, slots=True)
class Table:
    """A table; its first column names the rows."""

    head: Sequence[str]
    lines: Sequence[Sequence[Cell]]
    words: tuple[int, ...] = ()
    """Columns of words, beside the first."""
    title: str = ""
    """A line above; a table with a title is folded away."""
    is_open: bool = False
    """Whether it is shown however long it is."""

    @property
    def summary(self) -> str:
        """What stands for the table where it is folded away; empty where it is not."""
        is_long = len(self.lines) > MAX_OPEN_LINES and not self.is_open
        return self.title or (f"Table of {len(self.lines)} rows" if is_long else "")


@dataclass(frozen=True, slots=True)
class Figure:
    """A picture with a name and a caption."""

    name: str
    """Of its file, without ending."""
    picture: Picture
    caption: str
    is_wide: bool = False


@dataclass(frozen=True, slots=True)
class Fold:
    """Parts that are folded away behind a line."""

    title: str
    parts: "tuple[Part, ...]"


Part = str | Table | Figure | Fold


@dataclass(frozen=True, slots=True)
class Section:
    """A heading, and paragraphs, tables and pictures under it."""

    title: str
    parts: tuple[Part, ...]


def write_markdown(title: str, text: str, sections: Sequence[Section], page: Path, pictures: Path) -> None:
    """Write a page, and its pictures as PNG files for light paper into the folder `pictures`, which is emptied.

    Only `text` is Markdown: names of worlds and policies may hold anything.
    """
    pictures.mkdir(parents=True, exist_ok=True)
    for old in pictures.glob("*.png"):
        old.unlink()
    relative = pictures.relative_to(page.parent)
    blocks = [f"# {title}", text]
    for section in sections:
        blocks.append(f"## {_escape(section.title)}")
        blocks.extend(_markdown(part, pictures, str(relative)) for part in section.parts)
    write_file(page, "\n\n".join(blocks) + "\n")


def _markdown(part: Part, pictures: Path, relative: str) -> str:
    """Return a part as Markdown, and write its pictures."""
    if isinstance(part, Fold):
        return _fold(part.title, "\n\n".join(_markdown(one, pictures, relative) for one in part.parts))
    if isinstance(part, Figure):
        write_file(pictures / f"{part.name}.png", part.picture.light)
        caption = _escape(part.caption)
        return f"![{caption}]({relative}/{part.name}.png)\n\n*{caption}*"
    return _markdown_table(part) if isinstance(part, Table) else _escape(part)


def _fold(title: str, content: str) -> str:
    """Fold Markdown away; without the blank lines it would be taken for HTML."""
    return f"<details><summary>{_plain(title)}</summary>\n\n{content}\n\n</details>"


def to_html(sections: Sequence[Section], heading: str = "h2") -> str:
    """Return a page as a piece of HTML that carries its pictures."""
    pieces = []
    for section in sections:
        pieces.append(f"<{heading}>{html.escape(section.title)}</{heading}>")
        pieces.extend(_html(section.parts))
    return "\n".join(pieces)


def _html(parts: Sequence[Part]) -> Iterator[str]:
    """Yield parts as HTML; the small pictures among them stand side by side."""
    small = [part for part in parts if isinstance(part, Figure) and not part.is_wide]
    for part in parts:
        if isinstance(part, str):
            yield f"<p>{html.escape(part)}</p>"
        elif isinstance(part, Table):
            yield _html_table(part)
        elif isinstance(part, Fold):
            content = "".join(_html(part.parts))
            yield f"<details><summary>{html.escape(part.title)}</summary>{content}</details>"
        elif part.is_wide:
            yield _themed(part, "wide")
        elif part is small[0]:
            yield f'<div class="pair">{"".join(map(_themed, small))}</div>'


def _themed(figure: Figure, kind: str = "") -> str:
    """Return a figure element whose picture follows the reader's light or dark mode."""
    dark = f'<source media="(prefers-color-scheme: dark)" srcset="{data_url(figure.picture.dark)}">'
    return figure_element(data_url(figure.picture.light), figure.caption, dark, kind)


def figure_element(url: str, caption: str, sources: str = "", kind: str = "") -> str:
    """Return a figure element."""
    text = html.escape(caption)
    image = f'<picture>{sources}<img src="{url}" alt="{text}"></picture>'
    return f'<figure class="{kind}">{image}<figcaption>{text}</figcaption></figure>'


def data_url(content: bytes) -> str:
    """Return a URL that holds a PNG or GIF file."""
    kind = "gif" if content.startswith(b"GIF") else "png"
    return f"data:image/{kind};base64,{base64.b64encode(content).decode()}"


def _html_table(table: Table) -> str:
    lines = []
    for first, *others in table.lines:
        cells = "".join(
            f'<td class="{"best" if cell.is_best else "words" if k in table.words else ""}">{_linked(cell)}'
            f"<small>{html.escape(cell.note)}</small></td>"
            for k, cell in enumerate(others, start=1)
        )
        lines.append(f"<tr><th>{html.escape(first.text)}</th>{cells}</tr>")
    head = "".join(f"<th>{html.escape(heading)}</th>" for heading in table.head)
    content = f'<div class="table"><table><thead><tr>{head}</tr></thead><tbody>{"".join(lines)}</tbody></table></div>'
    if not table.summary:
        return content
    return f"<details><summary>{html.escape(table.summary)}</summary>{content}</details>"


def _linked(cell: Cell) -> str:
    text = html.escape(cell.text)
    return f'<a href="{html.escape(cell.link)}">{text}</a>' if cell.link else text


def _markdown_table(table: Table) -> str:
    align = ["---" if k in (0, *table.words) else "---:" for k in range(len(table.head))]
    lines = [[_markdown_cell(cell) for cell in line] for line in table.lines]
    content = "\n".join(f"| {' | '.join(cells)} |" for cells in ([_escape(h) for h in table.head], align, *lines))
    return _fold(table.summary, content) if table.summary else content


def _markdown_cell(cell: Cell) -> str:
    text = f"**{_escape(cell.text)}**" if cell.is_best else _escape(cell.text)
    return f"{text} <sub>{_escape(cell.note)}</sub>" if cell.note else text


def to_terminal(table: Table, title: str) -> rich.table.Table:
    """Return a table for the terminal; intervals stand in brackets."""
    shown = rich.table.Table(title=Text(title), title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    for k, heading in enumerate(table.head):
        shown.add_column(Text(heading), justify="right" if k else "left", no_wrap=k == 0, overflow="fold")
    for line in table.lines:
        texts = [Text(cell.text, style="bold" if cell.is_best else "") for cell in line]
        shown.add_row(*(text.append(f" ({c.note})", "dim") if c.note else text for text, c in zip(texts, line)))
    return shown


def _escape(text: str) -> str:
    """Return plain text as Markdown in one line."""
    return re.sub(r"[\\|_*`]|\](?=\()", r"\\\g<0>", _plain(text))


def _plain(text: str) -> str:
    """Return plain text as HTML in one line."""
    return html.escape(" ".join(text.split()), quote=False)

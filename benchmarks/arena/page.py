"""Report pages of text, tables and figures, as HTML, Markdown or terminal output."""

import base64
import html
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import jinja2
import rich.table
from rich import box
from rich.text import Text

from lidarnaut.agents.run_folder import csv_text
from lidarnaut.agents.statistics import Estimate
from lidarnaut.benchmarks.arena.measures import texts
from lidarnaut.benchmarks.arena.trace import slug
from lidarnaut.envs.files import own_folder, printable, write_file
from lidarnaut.envs.measures import Measure

MAX_OPEN_LINES = 10
"""Maximum number of rows of a table shown inline. HTML collapses longer tables; Markdown links to a CSV file."""


FEW = "*"
"""Mark of intervals of few starts."""


class Cell(NamedTuple):
    """Cell of a report table."""

    text: str
    note: str = ""
    """Small print after the text, such as a confidence interval."""
    is_best: bool = False
    link: str = ""
    """Target of a link, relative to the HTML report; ignored in Markdown."""
    few: int = 0
    """Number of starts if they are too few for an interval, whose note ends with `FEW`; otherwise 0."""

    @classmethod
    def of(cls, value: Estimate, measure: Measure, is_best: bool = False, sign: str = "") -> "Cell":
        text, note = texts(measure, value, sign, FEW)
        note = "" if note == FEW else note
        return cls(text, note, is_best, few=value.n if note.endswith(FEW) else 0)


class Table(NamedTuple):
    """Table of a report. The first column names the rows."""

    head: Sequence[str]
    lines: Sequence[Sequence[Cell]]
    words: tuple[int, ...] = ()
    """Indices of text columns, left-aligned like column 0; other columns are right-aligned."""
    is_open: bool = False
    """Whether the table is shown inline even if it is long."""

    @property
    def is_folded(self) -> bool:
        return len(self.lines) > MAX_OPEN_LINES and not self.is_open

    @property
    def note(self) -> str:
        """Explanation of the mark `FEW`; empty if no cell has it."""
        few = sorted({cell.few for line in self.lines for cell in line} - {0})
        if not few:
            return ""
        span = f"{few[0]} to {few[-1]}" if len(few) > 1 else few[0]
        return f"{FEW} only {span} start{'s' * (few != [1])}: bootstrap intervals of so few values are too narrow."


class Figure(NamedTuple):
    """PNG image of a report, with caption; `name` is the file name without suffix."""

    name: str
    content: bytes
    caption: str
    is_wide: bool = False

    @property
    def url(self) -> str:
        return f"data:image/png;base64,{base64.b64encode(self.content).decode()}"


class Frame(NamedTuple):
    """Self-contained HTML page, embedded in an HTML report."""

    page: str
    title: str


class Section(NamedTuple):
    """Section of a report: heading, texts, tables and figures. Sections inside a section are collapsed."""

    title: str
    parts: "tuple[Part, ...]"


class Markdown(str):
    """Text of an existing Markdown page, written as it is."""


Part = str | Table | Figure | Frame | Section


def to_html(sections: Sequence[Section], title: str) -> str:
    """Render report sections as one HTML file with embedded images."""
    folder = jinja2.FileSystemLoader(Path(__file__).parent)
    template = jinja2.Environment(loader=folder, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    return template.get_template("report.html").render(sections=sections, title=title)


def write_markdown(title: str, text: str, sections: Sequence[Section], page: Path, folder: Path) -> None:
    """Write a report as a Markdown page, with figures and long tables as files in `folder`.

    PNG and CSV files in `folder` that the page does not name are deleted. Text is escaped, except for `text` and
    `Markdown`.
    """
    own_folder(folder.parent, folder.name)
    blocks = [f"# {title}", text.strip()]
    for section in sections:
        blocks.append(f"## {_escape(section.title)}")
        blocks += [_markdown(part, section.title, folder) for part in section.parts]
    written = "\n\n".join(blocks) + "\n"
    write_file(page, written)
    for path in (*folder.glob("*.png"), *folder.glob("*.csv")):
        if f"({folder.name}/{path.name})" not in written:
            path.unlink()


def _markdown(part: Part, title: str, folder: Path) -> str:
    if isinstance(part, str):
        return part if isinstance(part, Markdown) else _escape(part)
    if isinstance(part, Figure):
        write_file(folder / f"{part.name}.png", part.content)
        return f"![{part.name}]({folder.name}/{part.name}.png)\n\n*{_escape(part.caption)}*"
    if isinstance(part, Frame):
        return _escape(part.title)
    if isinstance(part, Section):
        content = "\n\n".join(_markdown(one, title, folder) for one in part.parts)
        # Markdown inside `details` needs the blank lines.
        return f"<details><summary>{_plain(part.title)}</summary>\n\n{content}\n\n</details>"
    note = f"{_escape(part.note)}\n\n" * bool(part.note)
    if part.is_folded:
        name = f"{slug(title.lower().replace(' ', '_'))}.csv"
        lines = [[f"{cell.text} ({cell.note})" if cell.note else cell.text for cell in line] for line in part.lines]
        write_file(folder / name, csv_text([part.head, *lines]))
        return f"{note}[Table of {len(lines)} rows]({folder.name}/{name})"
    align = ["---" if k in (0, *part.words) else "---:" for k in range(len(part.head))]
    lines = [list(map(_escape, part.head)), align, *([_markdown_cell(cell) for cell in line] for line in part.lines)]
    return note + "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _markdown_cell(cell: Cell) -> str:
    text = f"**{_escape(cell.text)}**" if cell.is_best else _escape(cell.text)
    return f"{text} <sub>{_escape(cell.note)}</sub>" if cell.note else text


def _escape(text: str) -> str:
    return re.sub(r"[\\|_*`]|\](?=\()", r"\\\g<0>", _plain(text))


def _plain(text: str) -> str:
    return html.escape(" ".join(text.split()), quote=False)


def to_terminal(table: Table, title: str) -> rich.table.Table:
    title = f"{title}\n{table.note}".strip()
    shown = rich.table.Table(title=Text(printable(title)), title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    for k, heading in enumerate(table.head):
        shown.add_column(Text(printable(heading)), justify="right" if k else "left", no_wrap=k == 0, overflow="fold")
    for line in table.lines:
        shown_texts = [Text(printable(cell.text), style="bold" if cell.is_best else "") for cell in line]
        shown.add_row(*(text.append(f" ({c.note})", "dim") if c.note else text for text, c in zip(shown_texts, line)))
    return shown

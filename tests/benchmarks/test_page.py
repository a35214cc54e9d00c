import io
import re
from pathlib import Path

import pytest
from markdown_it import MarkdownIt
from rich.console import Console

from lidarnaut.benchmarks.arena.page import (
    MAX_OPEN_LINES,
    Cell,
    Figure,
    Section,
    Table,
    to_html,
    to_terminal,
    write_markdown,
)
from lidarnaut.benchmarks.arena.settings import Settings
from lidarnaut.evaluate_command import Command, shown_command

LONG = [[Cell("a"), Cell("1", "0 to 2")]] * (MAX_OPEN_LINES + 1)


def pages_of(folder, *sections):
    write_markdown("T", "See [Evaluation](evaluation.md).", sections, folder / "page.md", folder / "page")
    return (folder / "page.md").read_text(), to_html(sections, title="T")


def test_long_tables_are_folded_or_files_unless_they_stay_open(tmp_path):
    tables = Table(("", "x"), LONG), Table(("", "x"), LONG, is_open=True), Table(("", "x"), LONG[:3])
    page, report = pages_of(tmp_path, Section("Many rows", tables))
    assert report.count("<details><summary>Table of 11 rows</summary>") == report.count("</details>") == 1
    assert page.count("\n|  | x |\n") == 2
    assert "[Table of 11 rows](page/many_rows.csv)" in page
    assert (tmp_path / "page" / "many_rows.csv").read_text().splitlines()[:2] == [",x", "a,1 (0 to 2)"]


def test_few_starts_are_named_once_per_table(tmp_path):
    lines = [
        [Cell("a"), Cell("1", "0 to 2*", few=4)],
        [Cell("b"), Cell("3", "2 to 4*", few=2)],
        [Cell("c"), Cell("3", "2 to 5")],
    ]
    table = Table(("", "x"), lines)
    console = Console(file=io.StringIO(), width=100)
    console.print(to_terminal(table, "All"))
    for text in (*pages_of(tmp_path, Section("Few", (table,))), console.file.getvalue()):
        note, _, rest = " ".join(text.replace("\\", "").split()).partition("* only 2 to 4 starts: ")
        assert "2*" not in note
        assert rest.count("2*") == rest.count("4*") == 1


def test_folded_pictures_are_written_and_shown(tmp_path):
    figures = tuple(Figure(f"map_{k}", b"", f"map {k}", is_wide=k == 0) for k in range(3))
    page, report = pages_of(tmp_path, Section("Maps", (Section("all <maps>", ("text", *figures)),)))
    assert {path.name for path in (tmp_path / "page").iterdir()} == {"map_0.png", "map_1.png", "map_2.png"}
    assert "![map_1](page/map_1.png)\n\n*map 1*" in page
    for text in (page, report):
        assert "<details><summary>all &lt;maps&gt;</summary>" in text
    assert (report.count("<figure"), report.count('<div class="pair">')) == (3, 1)


HOSTILE = "maps/<img src=x onerror=alert(1)>&amp;[x](javascript:y)`\n# a|b_c.yaml"


def test_names_that_users_give_are_text_on_every_page(tmp_path):
    table = Table(("", HOSTILE), [[Cell(HOSTILE, HOSTILE), Cell(HOSTILE, is_best=True, link=HOSTILE)]])
    figure = Figure("map", b"", HOSTILE)
    page, report = pages_of(tmp_path, Section(HOSTILE, (HOSTILE, table, figure, Section(HOSTILE, (HOSTILE, table)))))
    rendered = MarkdownIt().enable("table").render(page)
    for text in (rendered, report):
        assert "<img src=x" not in text
        assert 'href="javascript' not in text
        assert text.count("maps/&lt;img src=x onerror=alert(1)&gt;&amp;amp;[x](javascript:y)`") >= 8
    assert 'See <a href="evaluation.md">Evaluation</a>.' in rendered
    assert rendered.count("<h1>") == 1
    assert rendered.count("</th>") == rendered.count("</td>") == 4
    console = Console(file=io.StringIO(), width=500)
    console.print(to_terminal(Table(("", "a [/b]"), [[Cell("[/x]"), Cell("1")]]), "world [/w].yaml"))
    assert {"[/b]", "[/x]", "world [/w].yaml"} <= set(re.findall(r"world \S+|\[/.\]", console.file.getvalue()))


SETTINGS = Settings(policies=("nearest",), worlds=("home=maps/home.yaml", "maze"))


@pytest.mark.parametrize(
    ("arguments", "out", "shown"),
    [
        ("--out OUT --publish docs --report", "/far/away/x", "--out runs/arena --publish docs"),
        ("--out=OUT --jobs 2", "/far/away/x", "--out=runs/arena --jobs 2"),
        ("--out OUT --publish HERE/docs", "HERE/runs/a", "--out runs/a --publish docs"),
        ("--out OUT", "runs/a", "--out runs/a"),
    ],
)
def test_the_command_on_a_page_names_no_folder_of_the_machine(arguments, out, shown):
    here = str(Path.cwd())
    out = out.replace("HERE", here)
    words = f"--config configs/arena.yaml {arguments}".replace("OUT", out).replace("HERE", here).split()
    command = Command(SETTINGS, Path(out), "configs/arena.yaml")
    assert shown_command(words, command) == f"python evaluate.py --config configs/arena.yaml {shown}"


def test_labels_name_worlds_and_nothing_else():
    named = dict.fromkeys((case.world, case.name("world")) for case, _ in SETTINGS.starts())
    assert list(named) == [("maps/home.yaml", "home"), ("maze", "maze")]

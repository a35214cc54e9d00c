"""Write the results of an evaluation."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from benchmarks.arena.leaderboard import (
    axis_sections,
    gap_section,
    measures_section,
    missing_section,
    origin_section,
    pairs_section,
    ranking_section,
    unfinished_section,
    worlds_section,
)
from benchmarks.arena.overview import curves_section, gallery_section
from benchmarks.arena.page import Section, write_markdown
from benchmarks.arena.pairs import common_starts, relate
from benchmarks.arena.plots import draw_world
from benchmarks.arena.ranking import rank
from benchmarks.arena.records import SETTINGS_FILE, Row, key_of, write_rows
from benchmarks.arena.report import build_report
from benchmarks.arena.runner import Evaluation, Failure, group_failures
from benchmarks.arena.summary import Summary, split, summarise, to_json
from benchmarks.arena.terminal import ranking_table, terminal_table
from benchmarks.arena.theme import short
from benchmarks.arena.trace import load_traces, slug
from benchmarks.arena.workers import Result
from envs.files import write_file

TITLE = "The arena"
"""Heading of the leaderboard's page."""
TEXT = (
    "Explorers meet the same worlds, from the same starts, with the same noise, and are measured against ground truth, "
    "which no competitor sees. "
)
"""First lines of that page."""
DOCS_TEXT = "[Evaluation](evaluation.md) explains measures and statistics; `arena/episodes.csv` holds the raw numbers."
"""Follows it in the documentation."""


def run_with_progress(evaluation: Evaluation, jobs: int, ray: str | None, console: Console) -> list[Failure]:
    """Run an evaluation behind a progress bar that shows the latest episode; return and say what could not be run."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("[dim]{task.fields[latest]}"),
    )
    with Progress(*columns, console=console) as progress:
        task = progress.add_task("episodes", total=evaluation.total, completed=evaluation.done, latest="")

        def on_result(result: Result) -> None:
            came = f"{100 * result.row['explored_fraction']:.0f} %" if result.row else "could not be run"
            latest = f"{short(result.key.policy)} in {result.key.world}: {came}"
            progress.update(task, advance=1, latest=latest)

        failures = evaluation.run(jobs, ray, on_result)
    for (where, reason), group in group_failures(failures).items():
        who = ", ".join(dict.fromkeys(short(one.key.policy) for one in group))
        line = f"{len(group)} episodes of {who} in {where} could not be run: {reason}"
        console.print(line, style="red", markup=False, highlight=False)
    return failures


def publish(evaluation: Evaluation, command: str = "", docs: Path | None = None, **report: Any) -> Summary:
    """Write `summary.json`, pictures, leaderboard and `report.html` into the folder of an evaluation.

    Args:
        evaluation: what the folder holds of it is published.
        command: that made it, to say so.
        docs: folder that gets the leaderboard as `arena.md`, and its pictures and the raw rows as `arena/`.
        report: further arguments of `build_report`.

    Raises:
        ValueError: if the folder holds nothing yet.
    """
    rows, folder, settings = evaluation.rows(), evaluation.folder, evaluation.settings
    if not rows:
        raise ValueError(f"{folder} holds no episode yet")
    summary, cases = summarise(rows), split(rows)
    write_file(folder / "summary.json", json.dumps(to_json(summary), indent=1) + "\n")
    pictures = {}
    for case, here in cases.items() if settings.world_sections else ():
        drawn = pictures[case] = draw_world(load_traces(folder, here))
        write_file(folder / f"curves_{slug(case)}_time.png", drawn.over_time.light)
        write_file(folder / f"curves_{slug(case)}_distance.png", drawn.over_distance.light)
        write_file(folder / f"growth_{slug(case)}.png", drawn.growth.light)
        for policy, picture in drawn.maps.items():
            write_file(folder / f"map_{slug(case)}_{slug(policy)}.png", picture.light)
    has_more = len(cases) > 1 or evaluation.slam_axis_rows() or evaluation.missing() or docs
    sections = _leaderboard(evaluation, rows, command) if has_more else []
    write_file(folder / "report.html", build_report(rows, settings, pictures, sections, **report))
    if sections:
        write_markdown(TITLE, TEXT, sections, folder / "leaderboard.md", folder / "leaderboard")
    if docs:
        write_markdown(TITLE, TEXT + DOCS_TEXT, sections, docs / "arena.md", docs / "arena")
        write_rows(docs / "arena" / "episodes.csv", _all_rows(evaluation))
    return summary


def _leaderboard(evaluation: Evaluation, rows: Sequence[Row], command: str) -> list[Section]:
    fair = relate(common_starts(rows))
    sections = [
        ranking_section(fair) if fair else None,
        curves_section(evaluation.folder, fair) if fair else None,
        gap_section(fair),
        pairs_section(fair) if fair else None,
        measures_section(fair) if fair else None,
        *axis_sections(_all_rows(evaluation)),
        worlds_section(rows),
        unfinished_section(rows),
        missing_section(evaluation.missing(), len(rows), len(fair)),
        gallery_section(evaluation.folder, rows),
        origin_section(evaluation.settings, json.loads((evaluation.folder / SETTINGS_FILE).read_text()), command),
    ]
    return [section for section in sections if section]


def _all_rows(evaluation: Evaluation) -> list[Row]:
    """Return the rows of the evaluation and of its SLAM axis, each once."""
    return list({key_of(row): row for row in (*evaluation.rows(), *evaluation.slam_axis_rows())}.values())


def print_results(evaluation: Evaluation, summary: Summary, messages: Console) -> None:
    """Print a table for every case, or where there are many the leaderboard, and say where the rest is."""
    console, folder = Console(), evaluation.folder
    cases = list(split(evaluation.rows()))
    for case in cases if evaluation.settings.world_sections else ():
        console.print(terminal_table(summary, case))
    if len(cases) > 1:
        console.print(ranking_table(rank(relate(common_starts(evaluation.rows())))))
    if missing := evaluation.missing():
        messages.print(f"{len(missing)} of the episodes are missing; {folder / 'report.html'} says why.")
    messages.print(
        f"Interquartile means [95 % intervals]. Report: {folder / 'report.html'}", highlight=False, markup=False
    )

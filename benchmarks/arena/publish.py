"""Write the results of an evaluation."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml
from rich.console import Console

from benchmarks.arena import leaderboard
from benchmarks.arena.measures import Measures
from benchmarks.arena.overview import curves_section, gallery_section, worst_section
from benchmarks.arena.page import Section, to_terminal, write_markdown
from benchmarks.arena.pairs import common_starts, held_out, relate, split
from benchmarks.arena.players import players_section
from benchmarks.arena.records import SETTINGS_FILE, Row, key_of, write_rows
from benchmarks.arena.report import build_report, draw_case
from benchmarks.arena.runner import Evaluation
from benchmarks.arena.summary import Summary, summarise, to_json
from benchmarks.arena.theme import short
from benchmarks.arena.trace import slug
from benchmarks.arena.unfinished import group_failures, missing_section, unfinished_section
from benchmarks.arena.verdict import verdict_section
from benchmarks.arena.workers import Result
from envs.command_line import make_console
from envs.files import write_file
from envs.measures import SUCCESS
from envs.progress import Progress

TITLE = "The arena"
TEXT = (
    "Policies meet the same worlds, from the same starts, with the same noise, and are measured against ground truth, "
    "which no competitor sees. "
)
"""First lines of the leaderboard's page."""
DOCS_TEXT = "[Evaluation](evaluation.md) explains measures and statistics; `arena/episodes.csv` holds the raw numbers."


def run_with_progress(
    evaluation: Evaluation, jobs: int, ray: str | None, console: Console, bags: Path | None = None, record: bool = False
) -> list[Result]:
    """Run an evaluation behind a progress bar that shows the latest episode; return and say what could not be run."""
    headline = evaluation.measures.headline
    with Progress(total=evaluation.total, initial=evaluation.done, desc="episodes", unit="episode") as bar:

        def on_result(result: Result) -> None:
            came = f"{headline.text(result.row[headline.name])} {headline.unit}" if result.row else "could not be run"
            bar.set_postfix_str(f"{short(result.key.policy)} in {result.key.world}: {came}", refresh=False)
            bar.update()

        failures = evaluation.run(jobs, ray, on_result, bags, record)
    for (where, reason), (number, who) in group_failures(failures).items():
        line = f"{number} episodes of {who} in {where} could not be run: {reason}"
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
    rows, folder, settings, measures = evaluation.rows(), evaluation.folder, evaluation.settings, evaluation.measures
    if not rows:
        raise ValueError(f"{folder} holds no episode yet")
    summary, cases = summarise(rows, measures), split(rows)
    write_file(folder / "summary.json", json.dumps(to_json(summary), indent=1) + "\n")
    shown_cases = cases if settings.world_sections else {}
    pictures = {case: draw_case(folder, here, measures.label) for case, here in shown_cases.items()}
    for case, drawn in pictures.items():
        for name, picture in drawn.items():
            write_file(folder / f"{name.format(slug(case))}.png", picture.light)
    # The rows of the evaluation and of its SLAM axis, each once.
    all_rows = list({key_of(row): row for row in (*rows, *evaluation.slam_axis_rows())}.values())
    has_more = len(cases) > 1 or evaluation.slam_axis_rows() or evaluation.missing() or docs
    sections = _leaderboard(evaluation, rows, all_rows, command) if has_more else []
    players = players_section(folder, rows, measures.headline)  # in the report alone: other pages lie elsewhere
    shown = [*sections[:1], players, *sections[1:]] if players else sections
    write_file(folder / "report.html", build_report(rows, summary, settings, measures, pictures, shown, **report))
    if sections:
        write_markdown(TITLE, TEXT, sections, folder / "leaderboard.md", folder / "leaderboard")
    if docs:
        write_markdown(TITLE, TEXT + DOCS_TEXT, sections, docs / "arena.md", docs / "arena")
        write_rows(docs / "arena" / "episodes.csv", evaluation.columns, all_rows)
    return summary


def _leaderboard(evaluation: Evaluation, rows: Sequence[Row], all_rows: Sequence[Row], command: str) -> list[Section]:
    folder, measures = evaluation.folder, evaluation.measures
    fair = relate(common_starts(rows), measures)
    about_fair = (
        [
            verdict_section(fair, measures),
            leaderboard.ranking_section(fair, measures),
            worst_section(folder, fair, measures),
            curves_section(folder, fair, measures),
            leaderboard.gap_section(fair, measures),
            leaderboard.pairs_section(fair, measures.gaps, measures.marks),
            leaderboard.measures_section(fair, measures),
        ]
        if fair
        else []
    )
    sections = [
        *about_fair,
        *leaderboard.axis_sections(all_rows, measures),
        leaderboard.worlds_section(rows, measures.timed),
        unfinished_section(rows, measures),
        missing_section(evaluation.missing(), len(rows), len(fair)),
        gallery_section(folder, rows, measures),
        _origin_section(evaluation, command),
    ]
    return [section for section in sections if section]


def _origin_section(evaluation: Evaluation, command: str) -> Section:
    """Say how the page came to be."""
    facts = evaluation.settings.model_dump(mode="json", exclude={"policies", "worlds", "world_sections"})
    versions = json.loads((evaluation.folder / SETTINGS_FILE).read_text())["versions"]
    parts = (
        f"Command: {command}",
        f"Settings: {yaml.safe_dump(facts, default_flow_style=True, width=10_000).strip()}",
        f"Versions: {', '.join(f'{name} {version}' for name, version in versions.items())}",
    )
    return Section("How it was made", parts)


def print_case(console: Console, summary: Summary, case: str, measures: Measures) -> None:
    """Print a case's estimates: a row per measure, a column per policy."""
    estimates = {policy: cases[case] for policy, cases in summary.items() if case in cases}
    episodes = max(values["success"].n for values in estimates.values())
    console.print(to_terminal(leaderboard.measures_table(estimates, measures), f"{case}, {episodes} episodes"))


def print_results(evaluation: Evaluation, summary: Summary, messages: Console) -> None:
    """Print a table for every case, or where there are many the leaderboard, and say where the rest is."""
    console, folder, measures = make_console(), evaluation.folder, evaluation.measures
    cases = list(split(evaluation.rows()))
    for case in cases if evaluation.settings.world_sections else ():
        print_case(console, summary, case, measures)
    if len(cases) > 1 or not evaluation.settings.world_sections:
        rows = relate(common_starts(evaluation.rows()), measures)
        printed = (measures.headline, *measures.relative[:1], *(measures.reached or (SUCCESS,)))
        for title, part in {
            "Worlds or robots that no training of the package saw": held_out(rows),
            "All worlds": rows,
        }.items():
            if part:
                console.print(to_terminal(leaderboard.ranking_table(part, measures.headline, printed), title))
    if missing := evaluation.missing():
        messages.print(f"{len(missing)} of the episodes are missing; {folder / 'report.html'} says why.", markup=False)
    messages.print(
        f"Interquartile means [95 % intervals]. Report: {folder / 'report.html'}", highlight=False, markup=False
    )

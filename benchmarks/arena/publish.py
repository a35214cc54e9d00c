"""Write the report and the leaderboard of an evaluation."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from rich.console import Console

from lidarnaut.agents.policy_names import short
from lidarnaut.agents.run_folder import write_table
from lidarnaut.benchmarks.arena import leaderboard, overview
from lidarnaut.benchmarks.arena.episodes import Episodes, Summary
from lidarnaut.benchmarks.arena.evaluation_folder import SETTINGS_FILE, Key
from lidarnaut.benchmarks.arena.page import Cell, Figure, Section, Table, to_html, to_terminal, write_markdown
from lidarnaut.benchmarks.arena.runner import Evaluation
from lidarnaut.benchmarks.arena.settings import estimator_of
from lidarnaut.benchmarks.arena.verdict import verdict_section
from lidarnaut.benchmarks.arena.workers import NOT_RUN, Result
from lidarnaut.envs.command_line import make_console
from lidarnaut.envs.files import printable, read_json, write_file
from lidarnaut.envs.measures import SUCCESS
from lidarnaut.envs.progress import Progress
from lidarnaut.envs.slam import base_name

TEXT = (
    "All policies run in the same worlds from the same starts with the same noise, and are measured against ground "
    "truth. Competitors do not observe ground truth, except for the pose if `slam` or `localizer` is `truth`. "
)
DOCS_TEXT = "See [measures and statistics](../reference/evaluation.md); `arena/episodes.csv` holds the raw numbers."


def run_with_progress(evaluation: Evaluation, jobs: int, console: Console, **how: Any) -> list[Result]:
    """Run the missing episodes of an evaluation with a progress bar; print and return the failed episodes.

    `how` are further arguments of `Evaluation.run`.
    """
    headline = evaluation.measures.headline
    with Progress(total=evaluation.total, initial=evaluation.done, desc="episodes", unit="episode") as bar:

        def on_result(result: Result) -> None:
            came = f"{headline.text(result.row[headline.name])} {headline.unit}" if result.row else "could not be run"
            bar.set_postfix_str(f"{short(result.key.policy)} in {result.key.world}: {came}", refresh=False)
            bar.update()

        failures = evaluation.run(jobs, on_result=on_result, **how)
    for (where, reason), (number, who) in group_failures(failures).items():
        line = f"{number} episodes of {who} in {where} could not be run: {reason}"
        console.print(printable(line), style="red", markup=False, highlight=False)
    return failures


def group_failures(failures: Sequence[Result]) -> dict[tuple[str, str], tuple[int, str]]:
    groups: dict[tuple[str, str], list[str]] = {}
    for failure in failures:
        where = f"{failure.key.world} with {failure.key.robot}"
        where += "" if base_name(failure.key.slam) else f" and {failure.key.slam}"
        groups.setdefault((where, failure.reason), []).append(short(failure.key.policy))
    return {group: (len(names), ", ".join(dict.fromkeys(names))) for group, names in groups.items()}


def publish(evaluation: Evaluation, command: str = "", docs: Path | None = None) -> Summary:
    """Write `summary.json`, figures, leaderboard and `report.html` to the folder of an evaluation.

    Args:
        evaluation: complete or incomplete evaluation.
        command: command line shown in the report.
        docs: if given, also write `arena.md` and `arena/` to this folder.

    Raises:
        ValueError: if no episode is finished.
    """
    folder, settings, measures = evaluation.folder, evaluation.settings, evaluation.measures
    episodes = Episodes(evaluation.rows(), measures)
    if not episodes:
        raise ValueError(f"{folder} holds no episode yet")
    axis_rows, cases, summary = evaluation.slam_axis_rows(), episodes.by_case(), episodes.summary()
    write_file(folder / "summary.json", json.dumps(to_json(summary), indent=1) + "\n")
    everything = Episodes({Key.of(row): row for row in (*episodes, *axis_rows)}.values(), measures)
    has_more = len(cases) > 1 or axis_rows or evaluation.missing() or docs
    sections = _leaderboard(evaluation, episodes, everything, command) if has_more else []
    report = list(filter(None, (*sections[:1], overview.players_section(folder, episodes), *sections[1:])))
    for case, here in cases.items() if settings.world_sections else ():
        estimates = {policy: summary[policy][case] for policy in here.policies}
        for section in overview.case_sections(folder, case, here, estimates):
            report.append(section)
            for figure in section.parts:
                if isinstance(figure, Figure):
                    write_file(folder / f"{figure.name}.png", figure.content)
    title = f"Evaluation of {settings.id}"
    write_file(folder / "report.html", to_html(report, title=title, facts=_facts(evaluation, episodes)))
    if sections:
        write_markdown("The arena", TEXT, sections, folder / "leaderboard.md", folder / "leaderboard")
    if docs:
        write_markdown("The arena", TEXT + DOCS_TEXT, sections, docs / "arena.md", docs / "arena")
        write_table(docs / "arena" / "episodes.csv", everything.rows)
    return summary


def to_json(summary: Mapping[str, Any]) -> dict[str, Any]:
    names = ("iqm", "low", "high", "n", "never")
    return {k: to_json(v) if isinstance(v, dict) else dict(zip(names, v)) for k, v in summary.items()}


def _leaderboard(evaluation: Evaluation, episodes: Episodes, everything: Episodes, command: str) -> list[Section]:
    folder, measures = evaluation.folder, evaluation.measures
    sections: list[Section | None] = []
    if fair := episodes.shared().related():
        sections = [
            verdict_section(fair),
            *leaderboard.ranking_sections(fair),
            overview.curves_section(folder, fair),
            leaderboard.pairs_section(fair, measures.gaps),
            leaderboard.measures_section(fair),
        ]
    sections += [
        # Not robots: their traversable cells, hence their starts, differ.
        *(leaderboard.axis_section(everything, axis) for axis in ("physics", "slam", "people")),
        leaderboard.worlds_section(episodes),
        leaderboard.unfinished_section(episodes),
        _missing_section(evaluation.missing(), len(episodes), len(fair)),
        overview.gallery_section(folder, episodes),
        _origin_section(evaluation, command),
    ]
    return list(filter(None, sections))


def _missing_section(missing: Sequence[Result], num_rows: int, num_fair: int) -> Section | None:
    if not missing:
        return None
    groups = group_failures([one for one in missing if one.reason != NOT_RUN])
    lines = [list(map(Cell, (where, str(number), who, why))) for (where, why), (number, who) in groups.items()]
    untried = sum(one.reason == NOT_RUN for one in missing)
    text = f"{len(missing)} episodes are missing, {untried} of them were {NOT_RUN}. " if untried else ""
    text += f"The leaderboard covers the starts common to all competitors: {num_fair} of {num_rows} episodes."
    table = Table(("world and robot", "episodes", "policies", "why"), lines, words=(2, 3))
    return Section("Not run", (text, table) if lines else (text,))


def _origin_section(evaluation: Evaluation, command: str) -> Section:
    facts = evaluation.settings.model_dump(mode="json", exclude={"policies", "worlds", "world_sections"})
    versions = read_json(evaluation.folder / SETTINGS_FILE)["versions"]
    parts = (
        f"Command: {command}",
        f"Settings: {yaml.safe_dump(facts, default_flow_style=True, width=10_000).strip()}",
        f"Versions: {', '.join(f'{name} {version}' for name, version in versions.items())}",
    )
    return Section("How it was made", parts)


def _facts(evaluation: Evaluation, episodes: Episodes) -> dict[str, Any]:
    settings = evaluation.settings
    columns = {name: name for name in ("robot", "physics", "people")} | {estimator_of(settings.id) or "slam": "slam"}
    seeds = [row["seed"] for row in episodes]
    return {
        "environment": settings.id,
        **settings.arguments,
        **{name: ", ".join(dict.fromkeys(row[column] for row in episodes)) for name, column in columns.items()},
        "episodes": len(episodes),
        "seeds": f"{min(seeds)} to {max(seeds)}",
    }


def print_results(evaluation: Evaluation, summary: Summary, messages: Console, all: bool = False) -> None:
    """Print a table per world, the leaderboard over several worlds, and the path of the report.

    `all` prints all measures.
    """
    console, report, measures = make_console(), printable(evaluation.folder / "report.html"), evaluation.measures
    episodes = Episodes(evaluation.rows(), measures)
    cases = episodes.by_case()
    for case, here in cases.items() if evaluation.settings.world_sections else ():
        estimates = {policy: summary[policy][case] for policy in here.policies}
        table = leaderboard.measures_table(estimates, measures.all if all else measures.brief)
        number = max(len(here.of(policy)) for policy in here.policies)
        console.print(to_terminal(table, f"{case}, {number} episodes"))
    if len(cases) > 1 or not evaluation.settings.world_sections:
        fair = episodes.shared().related()
        printed = (measures.headline, *measures.relative[:1], *(measures.reached or (SUCCESS,)))
        unseen = "Worlds or robots not used in training"
        for title, part in {unseen: fair.unseen(), "All worlds": fair}.items():
            if part:
                console.print(to_terminal(leaderboard.ranking_table(part, printed), title))
    if missing := evaluation.missing():
        messages.print(f"{len(missing)} of the episodes are missing; {report} says why.", markup=False)
    messages.print(
        f"Interquartile means (95 % intervals). Report with all measures: {report}", highlight=False, markup=False
    )

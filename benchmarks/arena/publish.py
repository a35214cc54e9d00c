"""Write the report and the leaderboard of an evaluation."""

import json
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from lidarnaut.agents.policy_names import short
from lidarnaut.agents.run_folder import write_table
from lidarnaut.benchmarks.arena import leaderboard, overview
from lidarnaut.benchmarks.arena.conditions import FinishedEvaluation, arguments_text
from lidarnaut.benchmarks.arena.episodes import Episodes, Summary, start_of
from lidarnaut.benchmarks.arena.evaluation_folder import SETTINGS_FILE
from lidarnaut.benchmarks.arena.page import Cell, Section, Table, to_html, to_terminal, write_markdown
from lidarnaut.benchmarks.arena.runner import Evaluation
from lidarnaut.benchmarks.arena.verdict import verdict_section
from lidarnaut.benchmarks.arena.workers import NOT_RUN, Result
from lidarnaut.envs.command_line import make_console
from lidarnaut.envs.files import parse_record, printable, read_json, write_file
from lidarnaut.envs.progress import Progress
from lidarnaut.envs.slam import base_name

TEXT = (
    "All policies run in the same worlds from the same starts with the same noise, and are measured against ground "
    "truth. Competitors do not observe ground truth, except for the pose if `slam` or `localizer` is `truth`. "
)
CONDITIONS_TEXT = (
    "Interquartile means have 95 % percentile intervals of the bootstrap (2000 resamples, stratified by world; worlds "
    "of fewer than 5 episodes together); proportions have Wilson intervals; ratios are geometric means over pairs of "
    "episodes from the same start. Times are simulated, distances are ground truth. A threshold that was not reached "
    "counts as the time limit, or as the distance that the robot could drive within it at full speed; such values are "
    "lower bounds (>), and k of n episodes reached it."
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


def publish(
    evaluation: Evaluation | FinishedEvaluation, command: str = "", docs: Path | None = None, reference: str = ""
) -> Summary:
    """Write `summary.json`, figures, leaderboard and `report.html` to the folder of an evaluation.

    Args:
        evaluation: complete or incomplete evaluation.
        command: command line shown in the report.
        docs: if given, also write `arena.md` and `arena/` to this folder.
        reference: name of the policy that the others are compared with; by default, the first one of `REFERENCES`.

    Raises:
        ValueError: if no episode is finished, or none of the policy `reference`.
    """
    folder, measures = evaluation.folder, evaluation.measures
    episodes = Episodes(evaluation.rows(), measures, reference)
    if not episodes:
        raise ValueError(f"{folder} holds no episode yet")
    if reference and reference not in episodes.policies:
        raise ValueError(f"reference {reference!r} has no episode; choose one of {', '.join(episodes.policies)}")
    summary = episodes.summary()
    write_file(folder / "summary.json", json.dumps(to_json(summary), indent=1) + "\n")
    sections = _sections(evaluation, episodes, command)
    players = overview.players_section(folder, episodes)
    report = [*sections[:1], *([players] if players else []), *sections[1:]]
    title = f"Evaluation of {evaluation.conditions.settings.get('id')}"
    write_file(folder / "report.html", to_html(report, title=title))
    write_markdown(title, TEXT, sections, folder / "leaderboard.md", folder / "leaderboard")
    if docs:
        write_markdown("The arena", TEXT + DOCS_TEXT, sections, docs / "arena.md", docs / "arena")
        write_table(docs / "arena" / "episodes.csv", episodes.rows)
    return summary


def to_json(summary: Mapping[str, Any]) -> dict[str, Any]:
    names = ("iqm", "low", "high", "n", "never")
    return {k: to_json(v) if isinstance(v, dict) else dict(zip(names, v)) for k, v in summary.items()}


def _sections(evaluation: Evaluation | FinishedEvaluation, episodes: Episodes, command: str) -> list[Section]:
    fair = episodes.shared()
    sections = [missing := _missing_section(evaluation.missing(), len(episodes), len(fair))]
    if fair:
        sections = [
            verdict_section(fair),
            missing,
            *leaderboard.ranking_sections(fair),
            overview.curves_section(evaluation.folder, fair),
        ]
    sections += [
        # Not robots: their traversable cells, hence their starts, differ.
        *(leaderboard.axis_section(episodes, axis) for axis in ("physics", "slam", "people")),
        leaderboard.worlds_section(episodes),
        leaderboard.unfinished_section(episodes),
        overview.gallery_section(evaluation.folder, episodes),
        _conditions_section(evaluation, episodes, command),
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


def _conditions_section(evaluation: Evaluation | FinishedEvaluation, episodes: Episodes, command: str) -> Section:
    """Return the report section for the methods section of a paper."""
    conditions, settings = evaluation.conditions, evaluation.conditions.settings
    facts = {"Environment": f"{settings.get('id')} {arguments_text(settings['arguments'])}", **conditions.facts}
    limits, starts = defaultdict[str, set[float]](set), defaultdict[str, set[int]](set)
    for row in episodes:
        limits[row["world"]].add(row["time_limit"])
        starts[row["world"]].add(row["seed"])
    for name, columns in {"Physics": "physics", "SLAM or localizer": "slam", "People": "people"}.items():
        facts[name] = ", ".join(dict.fromkeys(row[columns] for row in episodes))
    for world, seeds in starts.items():
        span = f"{min(limits[world]):.0f}" + (f" to {max(limits[world]):.0f}" if len(limits[world]) > 1 else "")
        facts[f"World {world}"] = f"{len(seeds)} starts, seeds {min(seeds)} to {max(seeds)}; time limit {span} s"
    for policy in episodes.policies:
        model, needed = episodes.of(policy)[0]["model"], conditions.policies.get(policy)
        facts[f"Policy {short(policy)}"] = "; ".join(filter(None, (f"weights {model}" * bool(model), needed)))
    file = evaluation.folder / SETTINGS_FILE
    versions = parse_record(read_json(file).get("versions"), f"{file}: versions", dict[str, str])
    facts |= {"Command": command, "Versions": ", ".join(f"{name} {one}" for name, one in versions.items())}
    lines = [[Cell(name), Cell(text)] for name, text in facts.items() if text]
    return Section("Conditions", (CONDITIONS_TEXT, Table(("", ""), lines, words=(1,), is_open=True)))


def print_results(evaluation: Evaluation | FinishedEvaluation, messages: Console, reference: str = "") -> None:
    """Print the leaderboard and the path of the report."""
    console, report, measures = make_console(), printable(evaluation.folder / "report.html"), evaluation.measures
    episodes = Episodes(evaluation.rows(), measures, reference)
    fair = episodes.shared() or episodes
    shown, number = measures.criteria if len(episodes.by_case()) > 1 else measures.brief, len(set(map(start_of, fair)))
    titles = "Worlds or robots not used in training", f"All {number} starts, interquartile means (95 % intervals)"
    for title, part in zip(titles, (fair.unseen(), fair)):
        if part:
            console.print(to_terminal(leaderboard.ranking_table(part, shown), title))
    if missing := evaluation.missing():
        messages.print(f"{len(missing)} of the episodes are missing; {report} says why.", markup=False)
    messages.print(f"Report with all measures: {report}", highlight=False, markup=False)

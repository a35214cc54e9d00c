"""The leaderboard: all results of an evaluation in many worlds, as a page."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import yaml

from benchmarks.arena.axis import COMPARED as AXIS_COMPARED
from benchmarks.arena.axis import SHOWN as AXIS_SHOWN
from benchmarks.arena.axis import compare_axis
from benchmarks.arena.measures import BY_NAME, MEASURES, Measure
from benchmarks.arena.page import Cell, Section, Table
from benchmarks.arena.pairs import BOUND, PAIRED_AXES, policies_of, pool, reference_of
from benchmarks.arena.ranking import GAPS, PRIMARY, SHOWN, Entry, gaps, rank
from benchmarks.arena.records import Row
from benchmarks.arena.runner import NOT_RUN, Failure, group_failures
from benchmarks.arena.settings import Settings
from benchmarks.arena.summary import best_of, compare, split
from benchmarks.arena.theme import short
from benchmarks.arena.unfinished import DRIFT, MARKS, find_unfinished

PERCENT = BY_NAME["reached_95"]
"""How shares are printed."""
TIME = BY_NAME["time_to_95"]
"""What the table of worlds shows."""
DASH = Cell("-")
"""An empty cell."""


def ranking_section(rows: Sequence[Row]) -> Section:
    """Return the ranking of the explorers over all worlds.

    Args:
        rows: related episodes (`benchmarks.arena.pairs.relate`) from starts that all competitors share.
    """
    entries = rank(rows)
    reference = reference_of(policies_of(rows))
    text = (
        f"Ranked by {PRIMARY.label}: the mean explored share over the whole time limit, which rewards being early as "
        "well as being complete. Interquartile means over all starts with 95 % stratified bootstrap intervals, shares "
        f"with Wilson's. Relative times and distances are shares of what {short(reference)} needed from the same start."
    )
    if any(entry.rank is None for entry in entries):
        text += (
            f" The {BOUND} uses the true map and the true pose: it is the bound of what can be reached, and not ranked."
        )
    return Section("Leaderboard", (text, _ranking_table(entries)))


def _ranking_table(entries: Sequence[Entry]) -> Table:
    best = {
        measure.name: best_of(
            {e.policy: e.estimates[measure.name] for e in entries if measure.name in e.estimates}, measure
        )
        for measure in SHOWN
    }
    lines = []
    for entry in entries:
        cells = [
            Cell.of(entry.estimates[m.name], m, entry.policy in best[m.name]) if m.name in entry.estimates else DASH
            for m in SHOWN
        ]
        rank = f"{entry.rank}. " if entry.rank else "bound: "
        lines.append((Cell(f"{rank}{short(entry.policy)}"), *cells))
    return Table(("", *(m.title for m in SHOWN)), tuple(lines))


def story(row: Row) -> str:
    """Say in a line how an episode went."""
    left = "" if row["success"] else f", {row['area_left']:.1f} m² left"
    return (
        f"{100 * row['explored_fraction']:.1f} % in {row['duration']:.0f} s and {row['path_length']:.0f} m "
        f"({row['end_reason'].replace('_', ' ')}{left}), map IoU {100 * row['map_iou']:.0f} %"
    )


def gap_section(rows: Sequence[Row]) -> Section | None:
    """Return how much of the gap from the reference to the bound each explorer closes; None without a bound.

    Args:
        rows: related episodes.
    """
    closed = {policy: found for policy in policies_of(rows) if (found := gaps(rows, policy))}
    if not closed:
        return None
    reference = short(reference_of(policies_of(rows)))
    text = (
        f"0 % is {reference}, 100 % the {BOUND}. What an explorer gains on {reference} from the same start, over what "
        f"the {BOUND} gains on it (interquartile means). No number where the {BOUND} does not clearly gain."
    )
    lines = []
    for policy, estimates in closed.items():
        cells = [DASH if np.isnan(value.iqm) else Cell.of(value, PERCENT) for value in estimates.values()]
        lines.append((Cell(short(policy)), *cells))
    return Section("Gap closed", (text, Table(("%", *(m.label for m in GAPS)), tuple(lines))))


def measures_section(rows: Sequence[Row]) -> Section:
    """Return all that the ranking leaves out.

    Args:
        rows: related episodes from starts that all competitors share.
    """
    others = [measure for measure in MEASURES if measure not in SHOWN]
    lines = []
    for policy in policies_of(rows):
        cells = [Cell.of(pool(rows, policy, measure), measure) for measure in others]
        lines.append((Cell(short(policy)), *cells))
    text = (
        "Interquartile means over the same starts as above. Seconds and metres in small and large worlds cannot be "
        "pooled in earnest: compare explorers, and not the numbers as such."
    )
    head = ("", *(m.title for m in others))
    return Section("All other measures", (text, Table(head, tuple(lines))))


def pairs_section(rows: Sequence[Row], measures: Sequence[Measure] = GAPS) -> Section | None:
    """Return every explorer against the reference, pair by pair; None if there is only one.

    Args:
        rows: episodes; related ones for relative measures.
        measures: in which they are compared. Where the rows are of several worlds, they should be comparable.
    """
    comparisons = compare(rows, measures)
    if not comparisons:
        return None
    reference = short(comparisons[0].reference)
    lines: dict[str, list[Cell]] = {}
    for c in comparisons:
        better = Cell.of(c.improvement, PERCENT)
        lines.setdefault(c.policy, [Cell(short(c.policy))]).extend(
            [Cell.of(c.difference, c.measure, sign="+"), Cell(f"{better.text} %", better.note)]
        )
    text = (
        f"Difference to {reference} from the same start (interquartile mean), and the probability of improvement: the "
        "share of starts from which the explorer does better, ties counting half."
    )
    head = ("", *(title for m in measures for title in (m.title, f"better than {reference}")))
    return Section("Pair by pair", (text, Table(head, tuple(map(tuple, lines.values())))))


def worlds_section(rows: Sequence[Row]) -> Section:
    """Return how long the explorers take in each world.

    Args:
        rows: all episodes.
    """
    policies = policies_of(rows)
    lines = []
    for case, here in split(rows).items():
        present = [policy for policy in policies if any(row["policy"] == policy for row in here)]
        estimates = {policy: pool(here, policy, TIME) for policy in present}
        best = best_of(estimates, TIME)
        cells = []
        for policy in policies:
            mine = [row for row in here if row["policy"] == policy]
            reached = sum(row["explored_fraction"] >= MARKS[0] for row in mine)
            note = "" if reached == len(mine) else f"{reached} of {len(mine)}"
            cells.append(Cell(TIME.texts(estimates[policy])[0], note, policy in best) if mine else DASH)
        lines.append((Cell(case), *cells))
    text = (
        "Seconds until 95 % was explored, interquartile mean. Where not every episode got there, how many did stands "
        "beside it; where the others decide the mean, it is a lower bound: more than the limit that they count as."
    )
    return Section("World by world", (text, Table(("", *map(short, policies)), tuple(lines))))


def axis_section(rows: Sequence[Row], axis: str) -> Section | None:
    """Return what the values of an axis cost the explorers; None if there is only one.

    Args:
        rows: all episodes.
        axis: column.
    """
    entries = compare_axis(rows, axis)
    if len({entry.value for entry in entries}) < 2:
        return None
    base = entries[0].base
    lines = []
    for entry in entries:
        shown = [Cell.of(entry.estimates[m.name], m) for m in AXIS_SHOWN]
        differences = [
            Cell.of(entry.differences[m.name], m, sign="+") if entry.differences else DASH for m in AXIS_COMPARED
        ]
        lines.append((Cell(f"{short(entry.policy)}, {entry.value}"), *shown, *differences))
    head = (
        *("", *(m.title for m in AXIS_SHOWN)),
        *(m.title + f", difference to {base}" for m in AXIS_COMPARED),
    )
    worlds = dict.fromkeys(world for entry in entries for world in entry.worlds)
    starts = entries[0].estimates[PRIMARY.name].n
    title = "What mapping error costs" if axis == "slam" else f"What {axis} costs"
    text = (
        f"The same explorers from the same {starts} starts in {', '.join(worlds)}. Differences are paired, those of "
        f"times and distances as shares of what the explorer needed under {base}."
    )
    return Section(title, (text, Table(head, tuple(lines))))


def axis_sections(rows: Sequence[Row]) -> list[Section]:
    """Return the sections of all axes along which episodes were run."""
    return [section for axis in PAIRED_AXES if (section := axis_section(rows, axis))]


def unfinished_section(rows: Sequence[Row]) -> Section:
    """Return which episodes did not get to the marks, where, and why."""
    found = find_unfinished(rows)
    parts: list[str | Table] = [
        f"Every episode that explored less than {100 * MARKS[1]:.0f} %, by explorer and world. A map counts as drifted "
        f"where the root mean square position error exceeds {DRIFT:.1f} m."
    ]
    head = ("world", "episodes", "below 95 %", "below 99 %", "least explored %", "left on average m²", "why it ended")
    for policy in policies_of(rows):
        mine = [one for one in found if one.policy == policy]
        total = sum(row["policy"] == policy for row in rows)
        below = [sum(one.below[k] for one in mine) for k in range(len(MARKS))]
        lines = tuple(
            (
                *(Cell(one.case), Cell(str(one.episodes)), *(Cell(str(number)) for number in one.below)),
                *(Cell(f"{100 * one.least_explored:.1f}"), Cell(f"{one.area_left:.1f}"), Cell(one.reasons)),
            )
            for one in mine
        )
        if lines:
            title = f"{short(policy)}: of {total} episodes {below[0]} below 95 %, {below[1]} below 99 %"
            parts.append(Table(head, lines, words=(6,), title=title))
    if len(parts) == 1:
        parts = ["Every episode explored 99 % or more."]
    return Section("Not finished", tuple(parts))


def missing_section(missing: Sequence[Failure], num_rows: int, num_fair: int) -> Section | None:
    """Return the episodes that could not be run, and why; None if none is missing.

    Args:
        missing: the episodes.
        num_rows: episodes that there are.
        num_fair: those of them from starts that all competitors share.
    """
    if not missing:
        return None
    lines = []
    for (where, reason), group in group_failures([one for one in missing if one.reason != NOT_RUN]).items():
        who = ", ".join(dict.fromkeys(short(one.key.policy) for one in group))
        lines.append((Cell(where), Cell(str(len(group))), Cell(who), Cell(reason)))
    untried = sum(failure.reason == NOT_RUN for failure in missing)
    text = f"{len(missing)} episodes are missing, {untried} of them were {NOT_RUN}. " if untried else ""
    text += f"The leaderboard counts the starts that all competitors have: {num_fair} of {num_rows} episodes."
    table = Table(("world and robot", "episodes", "explorers", "why"), tuple(lines), words=(2, 3))
    return Section("Not run", (text, table) if lines else (text,))


def origin_section(settings: Settings, folder_settings: dict[str, Any], command: str) -> Section:
    """Return how the page came to be.

    Args:
        settings: what was run.
        folder_settings: what `settings.json` holds.
        command: that made it.
    """
    facts = settings.model_dump(mode="json", exclude={"policies", "worlds", "world_sections"})
    versions = ", ".join(f"{name} {version}" for name, version in folder_settings["versions"].items())
    return Section(
        "How it was made",
        (
            f"Command: {command}",
            f"Settings: {yaml.safe_dump(facts, default_flow_style=True, width=10_000).strip()}",
            f"Versions: {versions}",
        ),
    )

"""The leaderboard: all results of an evaluation in many worlds, as sections of a page."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from benchmarks.arena.measures import Measures, share_of
from benchmarks.arena.page import Cell, Section, Table
from benchmarks.arena.pairs import (
    PAIRED_AXES,
    bound_of,
    by_start,
    from_shared_starts,
    held_out,
    paired_values,
    policies_of,
    pool,
    reference_of,
    relate,
    split,
    start_of,
)
from benchmarks.arena.policies import is_bound
from benchmarks.arena.records import Row
from benchmarks.arena.statistics import Estimate, paired_difference, paired_ratio, probability_of_improvement
from benchmarks.arena.summary import best_of, gaps, standing
from benchmarks.arena.theme import short
from envs.measures import SUCCESS, Measure

EASIEST = {"slam": "truth"}
"""Values that the others of their axis are compared with; where it is not among them, the first one."""
DASH = Cell("-")
LEAST = 1.0
"""Times and distances below count as this one in ratios: the first scan may show a small world as a whole [s, m]."""


def marked(estimates: Mapping[str, Estimate], measure: Measure) -> dict[str, Cell]:
    """Return a cell for each policy's estimate, the best ones marked."""
    best = best_of(estimates, measure)
    return {policy: Cell.of(value, measure, policy in best) for policy, value in estimates.items()}


def ranking_table(rows: Sequence[Row], headline: Measure, shown: Sequence[Measure]) -> Table:
    """Lay out the ranking by a headline: a row per policy, a column per measure; see `ranking_section`."""
    policies = list(standing(rows, headline))
    columns = []
    for measure in shown:
        known = {row["policy"] for row in rows if measure.name in row}
        columns.append(marked({policy: pool(rows, policy, measure) for policy in policies if policy in known}, measure))
    lines = []
    for k, policy in enumerate(policies, start=1):
        place = "bound:" if is_bound(policy) else f"{k}."
        lines.append([Cell(f"{place} {short(policy)}"), *(column.get(policy, DASH) for column in columns)])
    return Table(("", *(measure.title for measure in shown)), lines, is_open=True)


def ranking_section(rows: Sequence[Row], measures: Measures) -> Section:
    """Return the ranking of the policies over all worlds.

    Args:
        rows: related episodes (`benchmarks.arena.pairs.relate`) from starts that all competitors share.
        measures: of the task.
    """
    policies, headline = policies_of(rows), measures.headline
    text = (
        f"Ranked by {headline.label}{f': {headline.note}' if headline.note else ''}. Interquartile means over all "
        "starts with 95 % stratified bootstrap intervals, shares with Wilson's."
    )
    if measures.marks:
        text += (
            " Relative times and distances are shares of what "
            f"{short(reference_of(policies))} needed from the same start."
        )
    if bound_of(policies):
        text += " Who was given ground truth is a bound of what can be reached, and not ranked."
    tables = [ranking_table(rows, headline, measures.shown)]
    if unseen := held_out(rows):
        number, total = (len(set(map(start_of, part))) for part in (unseen, rows))
        text += (
            f" The first table is of the {number} starts in worlds or with robots that no training of the package saw."
        )
        tables = [
            ranking_table(unseen, headline, measures.shown),
            replace(tables[0], title=f"All {total} starts, those of training worlds too"),
        ]
    return Section("Leaderboard", (text, *tables))


def measures_table(estimates: Mapping[str, Mapping[str, Estimate]], measures: Measures) -> Table:
    """Lay out estimates, by policy and measure, with a row per measure and a column per policy."""
    lines = []
    for measure in measures.all:
        cells = marked({policy: values[measure.name] for policy, values in estimates.items()}, measure)
        lines.append([Cell(measure.title), *cells.values()])
    return Table(("", *map(short, estimates)), lines, is_open=True)


def story(row: Row, measures: Measures) -> str:
    """Say in a line how an episode went."""
    end = row["end_reason"].replace("_", " ")
    if "explored_fraction" not in row:
        value = f"{measures.headline.text(row[measures.headline.name])} {measures.headline.unit}".strip()
        where = f"{row['duration']:.0f} s and {row['path_length']:.0f} m"
        return f"{measures.headline.label} {value} in {where} ({end})"
    left = "" if row["success"] else f", {row['area_left']:.1f} m² left"
    return (
        f"{100 * row['explored_fraction']:.1f} % in {row['duration']:.0f} s and {row['path_length']:.0f} m "
        f"({end}{left}), map IoU {100 * row['map_iou']:.0f} %"
    )


def gap_section(rows: Sequence[Row], measures: Measures) -> Section | None:
    """Return how much of the gap from the reference to the bound each policy closes, from related episodes.

    None without a bound.
    """
    closed = {policy: found for policy in policies_of(rows) if (found := gaps(rows, policy, measures))}
    if not closed:
        return None
    reference, bound = short(reference_of(policies_of(rows))), bound_of(policies_of(rows))
    text = (
        f"0 % is {reference}, 100 % {bound}. What a policy gains on {reference} from the same start, over what "
        f"{bound} gains on it (interquartile means). No number where {bound} does not clearly gain."
    )
    lines = []
    for policy, estimates in closed.items():
        cells = [DASH if np.isnan(value.iqm) else Cell.of(value, SUCCESS) for value in estimates.values()]
        lines.append([Cell(short(policy)), *cells])
    return Section("Gap closed", (text, Table(("%", *(m.label for m in measures.gaps)), lines)))


def measures_section(rows: Sequence[Row], measures: Measures) -> Section:
    """Return all that the ranking leaves out, of related episodes from starts that all competitors share."""
    others = [measure for measure in measures.all if measure not in measures.shown]
    text = (
        "Interquartile means over the same starts as above. Seconds and metres in small and large worlds cannot be "
        "pooled in earnest: compare policies, and not the numbers as such."
    )
    lines = [
        [Cell(short(policy)), *(Cell.of(pool(rows, policy, measure), measure) for measure in others)]
        for policy in policies_of(rows)
    ]
    return Section("All other measures", (text, Table(("", *(m.title for m in others)), lines)))


def pairs_section(rows: Sequence[Row], measures: Sequence[Measure], marks: Sequence[Measure]) -> Section | None:
    """Return every policy against the reference on the starts that they share; None if there is only one.

    Args:
        rows: episodes; related ones for relative measures.
        measures: in which they are compared. Where the rows are of several worlds, they should be comparable.
        marks: times and distances of which there are ratios, too.
    """
    policies = policies_of(rows)
    reference = reference_of(policies)
    lines = []
    for policy in policies:
        cells = []
        for measure in measures:
            a, b = paired_values(rows, policy, reference, measure)
            if policy != reference and a:
                better = Cell.of(probability_of_improvement(a, b, bool(measure.higher_is_better)), SUCCESS)
                cells += [Cell.of(paired_difference(a, b), measure, sign="+"), Cell(f"{better.text} %", better.note)]
        for mark in marks if cells else ():
            a, b = ([values.clip(LEAST) for values in one] for one in paired_values(rows, policy, reference, mark))
            cells.append(Cell.of(paired_ratio(a, b), replace(share_of(mark), digits=3)))
        if cells:
            lines.append([Cell(short(policy)), *cells])
    if not lines:
        return None
    reference = short(reference)
    text = (
        f"Difference to {reference} from the same start (interquartile mean), and the probability of improvement: the "
        "share of starts from which the policy does better, ties counting half."
    )
    if marks:
        text += f" Ratios are geometric means; what was not reached counts as its limit, less than {LEAST:g} as that."
    head = ("", *(title for m in measures for title in (m.title, f"better than {reference}")))
    head += tuple(f"{mark.label} / {reference}'s" for mark in marks)
    return Section("Pair by pair", (text, Table(head, lines)))


def worlds_section(rows: Sequence[Row], measure: Measure) -> Section:
    """Return a measure of the policies in each world, from all episodes."""
    policies = policies_of(rows)
    lines = []
    for case, here in split(rows).items():
        cells = marked({policy: pool(here, policy, measure) for policy in policies_of(here)}, measure)
        for policy, cell in cells.items() if measure.limit else ():
            reached = [np.isfinite(row[measure.name]) for row in here if row["policy"] == policy]
            if any(reached):
                note = "" if all(reached) else f"{sum(reached)} of {len(reached)}"
                cells[policy] = Cell(cell.text, note, cell.is_best)
        lines.append([Cell(case), *(cells.get(policy, DASH) for policy in policies)])
    unit = f" [{measure.unit}]" if measure.unit else ""
    text = f"{measure.label[:1].upper()}{measure.label[1:]}{unit}, interquartile mean."
    if measure.limit:
        text += (
            " Where not every episode got there, how many did stands beside it; where the others decide the mean, it "
            "is a lower bound (>). Where none got there, that is the limit that they count as."
        )
    return Section("World by world", (text, Table(("", *map(short, policies)), lines)))


def axis_sections(rows: Sequence[Row], measures: Measures) -> list[Section]:
    """Return what the values of every axis along which episodes were run cost the policies."""
    return [section for axis in PAIRED_AXES if (section := axis_section(rows, axis, measures))]


def axis_section(rows: Sequence[Row], axis: str, measures: Measures) -> Section | None:
    """Compare the values of an axis, a column, pair by pair on the starts that all of them have; None if there is one.

    Differences of times and distances are shares of what the policy needed under the base (`EASIEST`).
    """
    values = list(dict.fromkeys(row[axis] for row in rows))
    if len(values) < 2:
        return None
    base = EASIEST[axis] if EASIEST.get(axis) in values else values[0]
    values.sort(key=lambda value: value != base)
    lines, compared = [], []
    for policy in policies_of(rows):
        # Under each value it stands for a policy of its own, from the same starts.
        versions = [row | {"policy": row[axis], axis: base} for row in rows if row["policy"] == policy]
        shared = relate(from_shared_starts(versions, values), measures, base)
        compared.append(by_start(shared, base))
        for value in values if shared else ():
            cells = [Cell.of(pool(shared, value, m), m) for m in measures.on_axes]
            for measure in measures.gaps:
                pairs = paired_values(shared, value, base, measure)
                cells.append(DASH if value == base else Cell.of(paired_difference(*pairs), measure, sign="+"))
            lines.append([Cell(f"{short(policy)}, {value}"), *cells])
    if not lines:
        return None
    worlds = dict.fromkeys(row["world"] for starts in compared for row in starts.values())
    num_starts = next(len(starts) for starts in compared if starts)
    text = f"The same policies from the same {num_starts} starts in {', '.join(worlds)}. Differences are paired" + (
        f", those of times and distances as shares of what the policy needed under {base}." if measures.marks else "."
    )
    head = ("", *(m.title for m in measures.on_axes), *(m.title + f", difference to {base}" for m in measures.gaps))
    errors = "What mapping error costs" if measures.marks else "What errors of the pose cost"
    return Section(errors if axis == "slam" else f"What {axis} costs", (text, Table(head, lines)))

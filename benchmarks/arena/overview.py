"""Pictures over all worlds: curves, performance profiles, typical and worst episodes."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.arena.leaderboard import story
from benchmarks.arena.measures import MARK, Measures
from benchmarks.arena.page import Cell, Figure, Fold, Section, Table
from benchmarks.arena.pairs import (
    Case,
    by_start,
    case_of,
    label_cases,
    policies_of,
    reference_of,
    start_of,
    value_of,
    values_of,
)
from benchmarks.arena.plots import NUM_POINTS, Bands, draw_curves, draw_growth, draw_profiles, sample_curves
from benchmarks.arena.records import Row
from benchmarks.arena.statistics import performance_profile
from benchmarks.arena.summary import competitors, typical_and_worst
from benchmarks.arena.theme import Picture, short
from benchmarks.arena.trace import Curve, Trace, load_curve, slug, trace_path
from envs.measures import Measure

SHARES = 3.0
"""Times and distances are shown up to this multiple of what the reference needed."""

NUM_WORST, NUM_WORST_MAPS = 5, 3
"""Worst episodes of the fastest explorer that are listed, and shown."""


def curves_section(folder: Path, rows: Sequence[Row], measures: Measures) -> Section:
    """Return progress over time and distance, and the performance profiles of tasks whose times are compared as shares.

    Args:
        folder: of the evaluation; holds the traces.
        rows: related episodes (`benchmarks.arena.pairs.relate`) from starts that all competitors share.
        measures: of the task.
    """
    reference, label = short(reference_of(policies_of(rows))), measures.label
    curves = _relative_curves(folder, rows, measures)
    unit, end = "of the limit", 1.0
    if measures.marks:
        unit, end = f"of {reference}'s to {measures.marks[0].label.removeprefix(MARK)}", SHARES
    drawn = {}
    for name, over, words in (("time", "time", "time"), ("distance", "path_length", "the distance driven")):
        bands = sample_curves(curves, over, end)  # type: ignore[arg-type]
        draw = partial(draw_curves, bands, f"{name}, as a share {unit}", label)
        drawn[f"curves_{name}"] = draw, f"{label.capitalize()} over {words}."
    if measures.marks:
        drawn |= _profiles(rows, list(curves), reference, measures)
    text = "Every start has its own unit: "
    text += f"what {reference} needed to explore 95 % from it" if measures.marks else "its limits of time and distance"
    text += ". Bands are 95 % intervals; dotted is the bound."
    figures = [Figure(name, Picture.of(draw), caption) for name, (draw, caption) in drawn.items()]
    return Section("Curves and performance profiles" if measures.marks else "Curves", (text, *figures))


def _profiles(
    rows: Sequence[Row], policies: Sequence[str], reference: str, measures: Measures
) -> dict[str, tuple[partial, str]]:
    """Return what draws the performance profiles of the headline and of the first share, with captions."""
    areas, shares = np.linspace(0.4, 1.0, NUM_POINTS), np.linspace(0.0, SHARES, NUM_POINTS)
    headline, mark = measures.headline.label, measures.marks[0].label.removeprefix(MARK)
    # Infinite where it was never reached.
    unlimited = replace(measures.relative[0], limit="")
    profiles, races = {}, {}
    for policy in policies:
        profiles[policy] = performance_profile(values_of(rows, policy, measures.headline), areas)
        races[policy] = performance_profile([-values for values in values_of(rows, policy, unlimited)], -shares)
    return {
        "profile_area": (
            partial(draw_profiles, Bands(areas, profiles), f"{headline} above"),
            f"Performance profile: share of episodes whose {headline} is above a threshold.",
        ),
        "profile_time": (
            partial(draw_profiles, Bands(shares, races), f"{mark} within this share of {reference}'s time"),
            f"Performance profile: share of episodes that reached {mark} within a share of {reference}'s time.",
        ),
    }


def worst_section(folder: Path, rows: Sequence[Row], measures: Measures) -> Section | None:
    """Return the episodes in which the fastest policy does worst against the reference, and the first of their maps.

    Args:
        folder: of the evaluation; holds the traces.
        rows: related episodes (`benchmarks.arena.pairs.relate`) from starts that all competitors share.
        measures: of the task.

    Returns:
        The section; None if the reference has no competitor, or nothing is compared as shares.
    """
    reference = reference_of(policies_of(rows))
    policy = next((name for name in competitors(rows, measures.decisive) if name != reference), None)
    if policy is None or not measures.marks:
        return None
    mark, relative, labels = measures.marks[0], measures.decisive, label_cases(rows)
    references = by_start(rows, reference)
    mine = [row for row in rows if row["policy"] == policy and start_of(row) in references]
    mine.sort(key=lambda row: -value_of(row, relative))
    lines, figures = [], []
    for k, row in enumerate(mine[:NUM_WORST], start=1):
        other = references[start_of(row)]
        where = f"{labels[case_of(row)]}, seed {row['seed']}"
        times = [_time_cell(row, mark), _time_cell(other, mark), Cell(relative.text(value_of(row, relative)))]
        endings = [
            f"{100 * one['explored_fraction']:.1f} %, {one['end_reason'].replace('_', ' ')}" for one in (row, other)
        ]
        lines.append([Cell(where), *times, *map(Cell, endings)])
        if k <= NUM_WORST_MAPS:
            traces = {one["policy"]: Trace.load(trace_path(folder, one)) for one in (row, other)}
            caption = f"{where}: {short(policy)} above, {short(reference)} below."
            figures.append(
                Figure(f"worst_against_{k}", Picture.of(partial(draw_growth, traces)), caption, is_wide=True)
            )
    names = (short(policy), short(reference))
    text = (
        f"The {len(lines)} starts from which {names[0]} needs most, measured by what {names[1]} needs from there, and "
        f"the maps of both from the first {len(figures)}. Colours: when a cell became known. Red: the true walls."
    )
    head = ("", *(f"{name}, {mark.title}" for name in names), "relative", *(f"{name} ends at" for name in names))
    return Section(f"Where {names[0]} does worst", (text, Table(head, lines, words=(4, 5)), *figures))


def _time_cell(row: Row, mark: Measure) -> Cell:
    """Show when an episode reached the mark."""
    if row[mark.name] <= row[mark.limit]:
        return Cell(mark.text(row[mark.name]))
    return Cell("never", f"> {mark.text(row[mark.limit])} {mark.unit}")


def gallery_section(folder: Path, rows: Sequence[Row], measures: Measures) -> Section:
    """Return film strips of a typical and of the worst of all episodes of every policy; `folder` holds the traces."""
    labels, headline = label_cases(rows), measures.headline
    strips = []
    for policy in policies_of(rows):
        figures = []
        for kind, row in zip(("typical", "worst"), typical_and_worst(rows, policy, headline), strict=True):
            trace = Trace.load(trace_path(folder, row))
            caption = f"{short(policy)}, {kind}: {labels[case_of(row)]}, seed {row['seed']}: {story(row, measures)}"
            picture = Picture.of(partial(draw_growth, {policy: trace}))
            figures.append(Figure(f"{kind}_{slug(policy)}", picture, caption, is_wide=True))
        strips.append(Fold(short(policy), tuple(figures)))
    text = (
        f"Of each policy the episode with the median {headline.label} over all worlds, and the one with the worst. "
        "The last picture of a strip is the final map. Colours: when a cell became known. Red: the true walls."
    )
    return Section("Typical and worst episodes", (text, *strips))


def _relative_curves(folder: Path, rows: Sequence[Row], measures: Measures) -> dict[str, list[list[Curve]]]:
    """Return each policy's curves by case, in shares of the limits, or of what the reference needed to the marks.

    What it saw at once is left out.
    """
    references = by_start(rows, reference_of(policies_of(rows)))
    curves: dict[str, dict[Case, list[Curve]]] = {}
    for row in rows:
        units = row["time_limit"], row["distance_limit"]
        if measures.marks:
            same_start = references.get(start_of(row))
            if same_start is None or any(same_start[mark.name] <= 0.0 for mark in measures.marks):
                continue
            marks = {mark.limit: value_of(same_start, mark) for mark in measures.marks}
            units = marks["time_limit"], marks.get("distance_limit", units[1])
        curve = load_curve(folder, row)
        scaled = Curve(curve.time / units[0], curve.path_length / units[1], curve.progress)
        curves.setdefault(row["policy"], {}).setdefault(case_of(row), []).append(scaled)
    return {policy: list(strata.values()) for policy, strata in curves.items()}

"""Pictures over all worlds: curves, performance profiles, typical and worst episodes."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from baselines.episode import Curve
from benchmarks.arena.leaderboard import story
from benchmarks.arena.measures import BY_NAME
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
from benchmarks.arena.summary import PRIMARY, by_relative_time, typical_and_worst
from benchmarks.arena.theme import Picture, short
from benchmarks.arena.trace import Trace, load_curve, slug, trace_path

TIME, DISTANCE = BY_NAME["time_to_95"], BY_NAME["distance_to_95"]
"""What the reference needed is the unit of the curves."""
SHARES = 3.0
"""Times and distances are shown up to this multiple of what the reference needed."""

NUM_WORST, NUM_WORST_MAPS = 5, 3
"""Worst episodes of the fastest explorer that are listed, and shown."""


def curves_section(folder: Path, rows: Sequence[Row]) -> Section:
    """Return the explored fraction over relative time and distance, and the performance profiles.

    Args:
        folder: of the evaluation; holds the traces.
        rows: related episodes (`benchmarks.arena.pairs.relate`) from starts that all competitors share.
    """
    reference = short(reference_of(policies_of(rows)))
    curves = _relative_curves(folder, rows)
    over_time, over_distance = (sample_curves(curves, over, SHARES) for over in ("time", "path_length"))
    areas, shares = np.linspace(0.4, 1.0, NUM_POINTS), np.linspace(0.0, SHARES, NUM_POINTS)
    profiles, races = {}, {}
    # Infinite where it was never reached.
    unlimited = replace(BY_NAME["relative_time"], limit="")
    for policy in curves:
        profiles[policy] = performance_profile(values_of(rows, policy, PRIMARY), areas)
        races[policy] = performance_profile([-values for values in values_of(rows, policy, unlimited)], -shares)
    drawn = {
        "curves_time": (
            partial(draw_curves, over_time, f"time, as a share of {reference}'s to 95 %"),
            "Explored over time.",
        ),
        "curves_distance": (
            partial(draw_curves, over_distance, f"distance, as a share of {reference}'s to 95 %"),
            "Explored over the distance driven.",
        ),
        "profile_area": (
            partial(draw_profiles, Bands(areas, profiles), "area under curve above"),
            "Performance profile: share of episodes whose area under the curve is above a threshold.",
        ),
        "profile_time": (
            partial(draw_profiles, Bands(shares, races), f"95 % within this share of {reference}'s time"),
            f"Performance profile: share of episodes that explored 95 % within a share of {reference}'s time.",
        ),
    }
    text = (
        f"Every start has its own unit: what {reference} needed to explore 95 % from it. Bands are 95 % intervals; "
        "dotted is the bound."
    )
    figures = [Figure(name, Picture.of(draw), caption) for name, (draw, caption) in drawn.items()]
    return Section("Curves and performance profiles", (text, *figures))


def worst_section(folder: Path, rows: Sequence[Row]) -> Section | None:
    """Return the episodes in which the fastest explorer does worst against the reference, and the first of their maps.

    Args:
        folder: of the evaluation; holds the traces.
        rows: related episodes (`benchmarks.arena.pairs.relate`) from starts that all competitors share.

    Returns:
        The section; None if the reference has no competitor.
    """
    reference = reference_of(policies_of(rows))
    policy = next((name for name in by_relative_time(rows) if name != reference), None)
    if policy is None:
        return None
    relative, labels = BY_NAME["relative_time"], label_cases(rows)
    references = by_start(rows, reference)
    mine = [row for row in rows if row["policy"] == policy and start_of(row) in references]
    mine.sort(key=lambda row: -value_of(row, relative))
    lines, figures = [], []
    for k, row in enumerate(mine[:NUM_WORST], start=1):
        other = references[start_of(row)]
        where = f"{labels[case_of(row)]}, seed {row['seed']}"
        times = [_time_cell(row), _time_cell(other), Cell(relative.text(value_of(row, relative)))]
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
    head = ("", *(f"{name}, {TIME.title}" for name in names), "relative", *(f"{name} ends at" for name in names))
    return Section(f"Where {names[0]} does worst", (text, Table(head, lines, words=(4, 5)), *figures))


def _time_cell(row: Row) -> Cell:
    """Show when an episode reached the mark."""
    if row[TIME.column] <= row[TIME.limit]:
        return Cell(TIME.text(row[TIME.column]))
    return Cell("never", f"> {TIME.text(row[TIME.limit])} {TIME.unit}")


def gallery_section(folder: Path, rows: Sequence[Row]) -> Section:
    """Return film strips of a typical and of the worst of all episodes of every explorer; `folder` holds the traces."""
    labels = label_cases(rows)
    strips = []
    for policy in policies_of(rows):
        figures = []
        for kind, row in zip(("typical", "worst"), typical_and_worst(rows, policy), strict=True):
            trace = Trace.load(trace_path(folder, row))
            caption = f"{short(policy)}, {kind}: {labels[case_of(row)]}, seed {row['seed']}: {story(row)}"
            picture = Picture.of(partial(draw_growth, {policy: trace}))
            figures.append(Figure(f"{kind}_{slug(policy)}", picture, caption, is_wide=True))
        strips.append(Fold(short(policy), tuple(figures)))
    text = (
        f"Of each explorer the episode with the median {PRIMARY.label} over all worlds, and the one with the lowest. "
        "The last picture of a strip is the final map. Colours: when a cell became known. Red: the true walls."
    )
    return Section("Typical and worst episodes", (text, *strips))


def _relative_curves(folder: Path, rows: Sequence[Row]) -> dict[str, list[list[Curve]]]:
    """Return each policy's curves by case, in units of what the reference needed; what it saw at once is left out."""
    references = by_start(rows, reference_of(policies_of(rows)))
    curves: dict[str, dict[Case, list[Curve]]] = {}
    for row in rows:
        unit = references.get(start_of(row))
        if unit is None or unit["time_to_95"] <= 0.0 or unit["distance_to_95"] <= 0.0:
            continue
        curve = load_curve(folder, row)
        scaled = Curve(
            curve.time / value_of(unit, TIME), curve.path_length / value_of(unit, DISTANCE), curve.explored_fraction
        )
        curves.setdefault(row["policy"], {}).setdefault(case_of(row), []).append(scaled)
    return {policy: list(strata.values()) for policy, strata in curves.items()}

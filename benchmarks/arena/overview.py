"""Figures of an evaluation: progress curves, performance profiles, maps, and pages that play episodes."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from lidarnaut.agents.policy_names import short
from lidarnaut.agents.statistics import performance_profile
from lidarnaut.benchmarks.arena.episodes import Case, Episodes, case_of, start_of, value_of
from lidarnaut.benchmarks.arena.evaluation_folder import Row
from lidarnaut.benchmarks.arena.measures import Measures, few_starts
from lidarnaut.benchmarks.arena.page import Cell, Figure, Section, Table
from lidarnaut.benchmarks.arena.plots import NUM_POINTS, draw_bands, draw_growth, render, sample_curves
from lidarnaut.benchmarks.arena.trace import (
    ProgressCurve,
    Trace,
    episode_name,
    load_curve,
    recording_path,
    slug,
    trace_path,
)
from lidarnaut.envs.files import own_folder, write_file
from lidarnaut.envs.player import Recording, build_page

MAX_RELATIVE = 3.0
"""Upper end of plot axes for time and distance, as a multiple of the reference policy's value."""


def curves_section(folder: Path, episodes: Episodes) -> Section:
    """Return a report section with curves of task progress over time and distance, which are relative if pooled.

    Tasks with a threshold also get performance profiles.
    """
    measures, reference, label = episodes.measures, short(episodes.reference), episodes.measures.label
    is_pooled = len(set(map(case_of, episodes))) > 1
    curves = _read_curves(folder, episodes, is_pooled)
    units, end = {"time": " [s]", "distance": " [m]"}, None
    text = f"Bands are 95 % intervals{few_starts(len(set(map(start_of, episodes))))}; the dotted curve is the bound."
    if is_pooled:
        whole, end = (f"{reference}'s to {measures.mark}", MAX_RELATIVE) if measures.marks else ("the limit", 1.0)
        units = dict.fromkeys(units, f", as a share of {whole}")
        text = f"Times and distances are shares of {whole} for the same start. {text}"
    figures = []
    few = few_starts(min((sum(map(len, strata)) for strata in curves.values()), default=0))
    for name, field, words in (("time", "time", "time"), ("distance", "path_length", "the distance driven")):
        picture = render(draw_bands, *sample_curves(curves, field, end), name + units[name], label, True)
        caption = f"{label.capitalize()} over {words}, with 95 % intervals{few}."
        figures.append(Figure(f"curves_{name}", picture, caption))
    if not measures.marks:
        return Section("Curves", (text, *figures))

    area, share = measures.headline, replace(measures.relative[0], limit="")
    within = f"{measures.mark} within this share of {reference}'s time"
    areas, shares = np.linspace(0.4, 1.0, NUM_POINTS), np.linspace(0.0, MAX_RELATIVE, NUM_POINTS)
    for name, measure, sign, thresholds, axis, those in (
        ("area", area, 1.0, areas, f"{area.label} above", f"with {area.label} above a threshold"),
        ("time", share, -1.0, shares, within, f"that reached {within.replace('this', 'a')}"),
    ):
        scores = {policy: [sign * values for values in episodes.values(policy, measure)] for policy in curves}
        bands = {policy: performance_profile(values, sign * thresholds) for policy, values in scores.items()}
        picture = render(draw_bands, thresholds, bands, axis, "share of episodes")
        figures.append(Figure(f"profile_{name}", picture, f"Performance profile: share of episodes {those}."))
    return Section("Curves and performance profiles", (text, *figures))


def _read_curves(folder: Path, episodes: Episodes, are_relative: bool) -> dict[str, list[list[ProgressCurve]]]:
    references, marks = episodes.by_start(episodes.reference), episodes.measures.marks if are_relative else ()
    curves: dict[str, dict[Case, list[ProgressCurve]]] = {}
    for row in episodes:
        units = {name: row[name] if are_relative else 1.0 for name in ("time_limit", "distance_limit")}
        if marks:
            same_start = references.get(start_of(row))
            if same_start is None or any(same_start[mark.name] <= 0.0 for mark in marks):
                continue
            units |= {mark.limit: value_of(same_start, mark) for mark in marks}
        curve = load_curve(folder, row)
        over = curve.time / units["time_limit"], curve.path_length / units["distance_limit"]
        curves.setdefault(row["policy"], {}).setdefault(case_of(row), []).append(ProgressCurve(*over, curve.progress))
    return {policy: list(strata.values()) for policy, strata in curves.items()}


def story(row: Row, measures: Measures) -> str:
    end, headline = row["end_reason"].replace("_", " "), measures.headline
    where = f"in {row['duration']:.0f} s and {row['path_length']:.0f} m"
    if "explored_fraction" not in row:
        return f"{headline.label} {headline.text(row[headline.name])} {headline.unit} {where} ({end})"
    left = "" if row["success"] else f", {row['area_left']:.1f} m² left"
    explored = f"{100 * row['explored_fraction']:.1f} %"
    return f"{explored} {where} ({end}{left}), map IoU {100 * row['map_iou']:.0f} %"


def gallery_section(folder: Path, episodes: Episodes) -> Section:
    strips = []
    for policy in episodes.policies:
        figures = []
        for kind, row in zip(("typical", "worst"), episodes.typical_and_worst(policy)):
            caption = f"{short(policy)}, {kind}: {episodes.place(row)}: {story(row, episodes.measures)}"
            picture = render(draw_growth, policy, Trace.load(trace_path(folder, row)))
            figures.append(Figure(f"{kind}_{slug(policy)}", picture, caption, is_wide=True))
        strips.append(Section(short(policy), tuple(figures)))
    text = (
        f"For each policy, the episodes with the median and the worst {episodes.measures.headline.label} over all "
        "worlds. The last image of a strip is the final map. Colours: time of first observation of a cell. Red: true "
        "walls."
    )
    return Section("Typical and worst episodes", (text, *strips))


def players_section(folder: Path, episodes: Episodes) -> Section | None:
    """Write pages that replay the median and the worst episode of every policy; return a report section with links."""
    recorded = episodes.where(lambda row: recording_path(folder, row).exists())
    if not recorded:
        return None
    own_folder(folder, "players")
    headline, reference = episodes.measures.headline, recorded.reference
    references, lines = recorded.by_start(reference), []
    for policy in recorded.policies:
        cells = [Cell(short(policy))]
        for row in recorded.typical_and_worst(policy):
            shown = [row] if policy == reference else [row, references.get(start_of(row))]
            page = f"players/{episode_name(row)}.html"
            write_file(folder / page, build_page([Recording.load(recording_path(folder, one)) for one in shown if one]))
            value = f"{headline.label} {headline.text(row[headline.name])} {headline.unit}"
            cells.append(Cell(episodes.place(row), value, link=page))
        lines.append(cells)
    text = (
        f"For each policy, replays of the episodes with the median and the worst {headline.label}, "
        f"next to {short(reference)} from the same start."
    )
    return Section("Episodes to play", (text, Table(("", "typical", "worst"), lines)))

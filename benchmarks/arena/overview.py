"""Figures of an evaluation: progress curves, maps, and pages that play episodes."""

from pathlib import Path

from lidarnaut.agents.policy_names import short
from lidarnaut.benchmarks.arena.episodes import Case, Episodes, case_of, start_of, value_of
from lidarnaut.benchmarks.arena.evaluation_folder import Row
from lidarnaut.benchmarks.arena.measures import Measures, few_starts
from lidarnaut.benchmarks.arena.page import Cell, Figure, Section, Table
from lidarnaut.benchmarks.arena.plots import draw_bands, draw_growth, render, sample_curves
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

MAX_RELATIVE = 2.0
"""Upper end of plot axes for time and distance, as a multiple of the reference policy's value."""


def curves_section(folder: Path, episodes: Episodes) -> Section | None:
    """Return a report section with curves of task progress over time and distance, which are relative if pooled.

    None if no policy has a stored episode from every start.
    """
    measures, reference, label = episodes.measures, short(episodes.reference), episodes.measures.label
    is_pooled = len(set(map(case_of, episodes))) > 1
    if not (curves := _read_curves(folder, episodes, is_pooled)):
        return None
    units, end = {"time": " [s]", "distance": " [m]"}, None
    text = f"Bands are 95 % intervals{few_starts(len(set(map(start_of, episodes))))}."
    text += " The dotted curve is the bound." if episodes.bound in curves else ""
    if is_pooled:
        mark = "".join(measure.label for measure in measures.marks[:1]).removeprefix("time")
        whole, end = (f"{reference}'s{mark}", MAX_RELATIVE) if mark else ("the limit", 1.0)
        units = dict.fromkeys(units, f", as a share of {whole}")
        text = f"Times and distances are shares of {whole} for the same start. {text}"
    figures = []
    for name, field, words in (("time", "time", "time"), ("distance", "path_length", "the distance driven")):
        picture = render(draw_bands, *sample_curves(curves, field, end), name + units[name], label)
        figures.append(Figure(f"curves_{name}", picture, f"{label.capitalize()} over {words}, with 95 % intervals."))
    return Section("Curves", (text, *figures))


def _read_curves(folder: Path, episodes: Episodes, are_relative: bool) -> dict[str, list[list[ProgressCurve]]]:
    references, marks = episodes.by_start(episodes.reference), episodes.measures.marks if are_relative else ()
    curves: dict[str, dict[Case, list[ProgressCurve]]] = {}
    for row in episodes.where(lambda row: trace_path(folder, row).exists()):
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
    shown = next((one for one in measures.own if one.name == "explored_fraction"), measures.headline)
    end, value = row["end_reason"].replace("_", " "), shown.text(row[shown.name])
    where = f"in {row['duration']:.0f} s and {row['path_length']:.0f} m"
    return f"{shown.label} {value} {shown.unit} {where} ({end})"


def gallery_section(folder: Path, episodes: Episodes) -> Section | None:
    """Return a report section with maps of typical and worst episodes; None without their stored traces."""
    strips, episodes = [], episodes.where(lambda row: trace_path(folder, row).exists())
    for policy in episodes.policies:
        figures = []
        for kind, row in zip(("typical", "worst"), episodes.typical_and_worst(policy)):
            caption = f"{short(policy)}, {kind}: {episodes.place(row)}: {story(row, episodes.measures)}"
            picture = render(draw_growth, policy, Trace.load(trace_path(folder, row)))
            figures.append(Figure(f"{kind}_{slug(policy)}", picture, caption, is_wide=True))
        strips.append(Section(short(policy), tuple(figures)))
    text = (
        f"For each policy, the episodes with the median and the worst {episodes.measures.headline.label} over all "
        "worlds. The last image of a strip is the final map, with people in orange. Colours: time of first observation "
        "of a cell, unless the map was given. Red: true walls. Green ring: goal."
    )
    return Section("Typical and worst episodes", (text, *strips)) if strips else None


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

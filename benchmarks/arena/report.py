"""The report of an evaluation: one HTML file that needs nothing else."""

import html
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from string import Template

import numpy as np

from benchmarks.arena.leaderboard import measures_table, pairs_section, story
from benchmarks.arena.measures import MARK, Measures, texts
from benchmarks.arena.page import Cell, Figure, Section, Table, data_url, figure_element, to_html
from benchmarks.arena.pairs import split
from benchmarks.arena.plots import draw_curves, draw_growth, draw_map, sample_curves
from benchmarks.arena.records import Row
from benchmarks.arena.settings import Settings, estimator_of
from benchmarks.arena.statistics import Estimate
from benchmarks.arena.summary import Summary
from benchmarks.arena.theme import DARK, LIGHT, Picture, Theme, short
from benchmarks.arena.trace import Trace, slug, trace_path

Estimates = Mapping[str, Mapping[str, Estimate]]
"""Estimates by policy and measure."""
Pictures = Mapping[str, Picture]
"""Pictures of a case, by the names of their files without ending; `{}` stands for the case."""

_TEMPLATE = Path(__file__).with_name("report.html")
_GROWTH_CAPTION = "All from the same start. Colours: when a cell became known. Red: the true walls."


def draw_case(folder: Path, rows: Sequence[Row], label: str) -> Pictures:
    """Draw the episodes of one case: curves of all, and maps of each policy's first.

    Args:
        folder: of the evaluation; holds the traces.
        rows: of the case.
        label: what the curves show.
    """
    traces: dict[str, list[Trace]] = {}
    for row in rows:
        traces.setdefault(row["policy"], []).append(Trace.load(trace_path(folder, row)))
    curves = {policy: [[trace.curve for trace in episodes]] for policy, episodes in traces.items()}
    over_time, over_distance = sample_curves(curves, "time"), sample_curves(curves, "path_length")
    firsts = {policy: episodes[0] for policy, episodes in traces.items()}
    growth = {"growth_{}": Picture.of(partial(draw_growth, firsts))} if _have_grown(firsts.values()) else {}
    return {
        "curves_{}_time": Picture.of(partial(draw_curves, over_time, "time [s]", label)),
        "curves_{}_distance": Picture.of(partial(draw_curves, over_distance, "distance driven [m]", label)),
        **growth,
        **{f"map_{{}}_{slug(policy)}": Picture.of(partial(draw_map, trace)) for policy, trace in firsts.items()},
    }


def _have_grown(traces: Iterable[Trace]) -> bool:
    """Tell whether maps were made in some of the episodes."""
    return any(trace.has_grown for trace in traces)


def build_report(
    rows: Sequence[Row],
    summary: Summary,
    settings: Settings,
    measures: Measures,
    pictures: Mapping[str, Pictures],
    leaderboard: Sequence[Section] = (),
    title: str | None = None,
    intro: str = "",
    lead: Mapping[str, bytes] = {},
) -> str:
    """Return the report as HTML.

    Args:
        rows: all episodes.
        summary: of them.
        settings: of the evaluation.
        measures: of the task.
        pictures: of each case that is to have a section.
        leaderboard: shown above those.
        title: heading; None for one by the task.
        intro: paragraph under the heading.
        lead: further pictures to show above the results: contents of PNG or GIF files by caption.
    """
    policies = list(summary)
    figures = "".join(figure_element(data_url(content), caption) for caption, content in lead.items())
    worlds = [to_html(leaderboard)]
    for case, here in split(rows).items():
        if case in pictures:
            estimates = {policy: summary[policy][case] for policy in policies if case in summary[policy]}
            worlds += [f"<h2>{html.escape(case)}</h2>", _cards(estimates, measures)]
            worlds.append(to_html(_sections(here, estimates, pictures[case], measures), heading="h3"))
    return Template(_TEMPLATE.read_text()).substitute(
        title=html.escape(title or f"How well do they do? {settings.id}"),
        intro=f"<p>{html.escape(intro)}</p>" if intro else "",
        facts=_facts(rows, settings),
        lead=f'<div class="pair">{figures}</div>' if figures else "",
        worlds="".join(worlds),
        light_colors=_color_variables(LIGHT, policies),
        dark_colors=_color_variables(DARK, policies),
    )


def _facts(rows: Sequence[Row], settings: Settings) -> str:
    seeds = [row["seed"] for row in rows]
    facts = {
        "environment": settings.id,
        **{name: str(value) for name, value in settings.arguments.items()},
        **{name: ", ".join(dict.fromkeys(row[name] for row in rows)) for name in ("robot", "physics")},
        estimator_of(settings.id) or "slam": ", ".join(dict.fromkeys(row["slam"] for row in rows)),
        "episodes": str(len(rows)),
        "seeds": f"{min(seeds)} to {max(seeds)}",
    }
    return "".join(f"<li><span>{name}</span> <b>{html.escape(value)}</b></li>" for name, value in facts.items())


def _sections(rows: Sequence[Row], estimates: Estimates, pictures: Pictures, measures: Measures) -> list[Section]:
    """Return what there is to say about a case: its curves, measures, comparisons, endings and maps."""
    seed = rows[0]["seed"]
    maps = []
    for policy in estimates:
        row = next(row for row in rows if row["policy"] == policy)
        start = "" if row["seed"] == seed else f"seed {row['seed']}: "
        maps.append(Figure("map", pictures[f"map_{{}}_{slug(policy)}"], f"{policy}: {start}{story(row, measures)}"))
    curves = (
        Figure("over_time", pictures["curves_{}_time"], "Over time. Bands are 95 % intervals."),
        Figure("over_distance", pictures["curves_{}_distance"], "Over the distance driven."),
    )
    growth = []
    if picture := pictures.get("growth_{}"):
        figure = Figure("growth", picture, _GROWTH_CAPTION, is_wide=True)
        growth = [Section(f"How the maps grew (seed {seed})", (figure,))]
    return [
        Section(f"{measures.label.capitalize()} over time and distance", curves),
        Section("All measures", (measures_table(estimates, measures),)),
        pairs_section(rows, measures.compared, measures.marks)
        or Section("Pair by pair", ("There is no other policy to compare with.",)),
        Section("How the episodes ended", (_endings_table(rows, list(estimates)),)),
        *growth,
        Section(f"Final maps (seed {seed})", tuple(maps)),
    ]


def _cards(estimates: Estimates, measures: Measures) -> str:
    """Return a card per policy: how much was done, or the headline, and when the mark was reached, or how often."""
    main = next((measure for measure in measures.shown if measure.name == measures.progress), measures.headline)
    cards = []
    for k, (policy, values) in enumerate(estimates.items()):
        value = values[main.name]
        lines = [f"{100 * values['success'].iqm:.0f} % succeeded", f"of {value.n} episodes"]
        for mark in measures.marks[:1]:
            time, name = values[mark.name], mark.label.removeprefix(MARK)
            reached = time.n - time.never
            when = f"after {texts(mark, time)[0]}{'' if time.is_bound[0] else f' {mark.unit}'}" if reached else "never"
            lines = [f"{name} {when}", f"in {reached} of {value.n} episodes"]
        rest = "".join(f"<div>{html.escape(line)}</div>" for line in (main.label, *lines))
        big = html.escape(f"{main.text(value.iqm)} {main.unit}")
        cards.append(
            f'<div class="card" style="--color: var(--policy-{k})"><h4>{html.escape(policy)}</h4>'
            f'<div class="big">{big}</div>{rest}</div>'
        )
    return f'<div class="cards">{"".join(cards)}</div>'


def _endings_table(rows: Sequence[Row], policies: Sequence[str]) -> Table:
    """Say for every policy why its episodes ended, and of explorations how much was left without success."""
    lines = []
    for policy in policies:
        mine = [row for row in rows if row["policy"] == policy]
        reasons = Counter(row["end_reason"].replace("_", " ") for row in mine).most_common()
        line = [Cell(short(policy)), Cell(", ".join(f"{reason}: {count}" for reason, count in reasons))]
        if "area_left" in mine[0]:
            left = [row["area_left"] for row in mine if not row["success"]]
            line.append(Cell(f"{np.mean(left):.1f} m²" if left else "none"))
        lines.append(line)
    head = ("", "episodes", "left unexplored, on average, when not covered")
    return Table(head[: len(lines[0])], lines, words=(1,))


def _color_variables(theme: Theme, policies: Sequence[str]) -> str:
    colors = theme.colors(policies)
    return " ".join(f"--policy-{k}: {colors[policy]};" for k, policy in enumerate(policies))

"""The report of an evaluation: one HTML file that needs nothing else."""

import html
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from string import Template

import numpy as np

from benchmarks.arena.leaderboard import measures_table, pairs_section, story
from benchmarks.arena.measures import BY_NAME
from benchmarks.arena.page import Cell, Figure, Section, Table, data_url, figure_element, to_html
from benchmarks.arena.pairs import split
from benchmarks.arena.plots import draw_curves, draw_growth, draw_map, sample_curves
from benchmarks.arena.records import Row
from benchmarks.arena.settings import Settings
from benchmarks.arena.statistics import Estimate
from benchmarks.arena.summary import Summary
from benchmarks.arena.theme import DARK, LIGHT, Picture, Theme, short
from benchmarks.arena.trace import Trace, slug, trace_path

Estimates = Mapping[str, Mapping[str, Estimate]]
"""Estimates by policy and measure."""
Pictures = Mapping[str, Picture]
"""Pictures of a case, by the names of their files without ending; `{}` stands for the case."""

COMPARED = tuple(BY_NAME[name] for name in ("area_under_curve", "time_to_95", "distance_to_95"))
"""Measures in which policies are compared pair by pair in one world."""
_TEMPLATE = Path(__file__).with_name("report.html")
_GROWTH_CAPTION = "All from the same start. Colours: when a cell became known. Red: the true walls."


def draw_case(folder: Path, rows: Sequence[Row]) -> Pictures:
    """Draw the episodes of one case: curves of all, and maps of each policy's first; `folder` holds the traces."""
    traces: dict[str, list[Trace]] = {}
    for row in rows:
        traces.setdefault(row["policy"], []).append(Trace.load(trace_path(folder, row)))
    curves = {policy: [[trace.curve for trace in episodes]] for policy, episodes in traces.items()}
    over_time, over_distance = sample_curves(curves, "time"), sample_curves(curves, "path_length")
    firsts = {policy: episodes[0] for policy, episodes in traces.items()}
    return {
        "curves_{}_time": Picture.of(partial(draw_curves, over_time, "time [s]")),
        "curves_{}_distance": Picture.of(partial(draw_curves, over_distance, "distance driven [m]")),
        "growth_{}": Picture.of(partial(draw_growth, firsts)),
        **{f"map_{{}}_{slug(policy)}": Picture.of(partial(draw_map, trace)) for policy, trace in firsts.items()},
    }


def build_report(
    rows: Sequence[Row],
    summary: Summary,
    settings: Settings,
    pictures: Mapping[str, Pictures],
    leaderboard: Sequence[Section] = (),
    title: str = "How well do they explore?",
    intro: str = "",
    lead: Mapping[str, bytes] = {},
) -> str:
    """Return the report as HTML.

    Args:
        rows: all episodes.
        summary: of them.
        settings: of the evaluation.
        pictures: of each case that is to have a section.
        leaderboard: shown above those.
        title: heading.
        intro: paragraph under the heading.
        lead: further pictures to show above the results: contents of PNG or GIF files by caption.
    """
    policies = list(summary)
    figures = "".join(figure_element(data_url(content), caption) for caption, content in lead.items())
    worlds = [to_html(leaderboard)]
    for case, here in split(rows).items():
        if case in pictures:
            estimates = {policy: summary[policy][case] for policy in policies if case in summary[policy]}
            worlds += [f"<h2>{html.escape(case)}</h2>", _cards(estimates)]
            worlds.append(to_html(_sections(here, estimates, pictures[case]), heading="h3"))
    return Template(_TEMPLATE.read_text()).substitute(
        title=html.escape(title),
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
        "robot": ", ".join(dict.fromkeys(row["robot"] for row in rows)),
        "physics": ", ".join(settings.physics),
        "SLAM": ", ".join(settings.slam),
        "episodes": str(len(rows)),
        "seeds": f"{min(seeds)} to {max(seeds)}",
    }
    return "".join(f"<li><span>{name}</span> <b>{html.escape(value)}</b></li>" for name, value in facts.items())


def _sections(rows: Sequence[Row], estimates: Estimates, pictures: Pictures) -> list[Section]:
    """Return what there is to say about a case: its curves, measures, comparisons, endings and maps."""
    seed = rows[0]["seed"]
    maps = []
    for policy in estimates:
        row = next(row for row in rows if row["policy"] == policy)
        start = "" if row["seed"] == seed else f"seed {row['seed']}: "
        maps.append(Figure("map", pictures[f"map_{{}}_{slug(policy)}"], f"{policy}: {start}{story(row)}"))
    curves = (
        Figure("over_time", pictures["curves_{}_time"], "Over time. Bands are 95 % intervals."),
        Figure("over_distance", pictures["curves_{}_distance"], "Over the distance driven."),
    )
    growth = Figure("growth", pictures["growth_{}"], _GROWTH_CAPTION, is_wide=True)
    return [
        Section("Explored over time and distance", curves),
        Section("All measures", (measures_table(estimates),)),
        pairs_section(rows, COMPARED) or Section("Pair by pair", ("There is no other policy to compare with.",)),
        Section("How the episodes ended", (_endings_table(rows, list(estimates)),)),
        Section(f"How the maps grew (seed {seed})", (growth,)),
        Section(f"Final maps (seed {seed})", tuple(maps)),
    ]


def _cards(estimates: Estimates) -> str:
    cards = []
    for k, (policy, values) in enumerate(estimates.items()):
        explored, time = values["explored_fraction"], values["time_to_95"]
        reached = time.n - time.never
        middle = BY_NAME["time_to_95"].texts(time)[0]
        when = f"95 % after {middle}{'' if time.is_bound[0] else ' s'}" if reached else "95 % never"
        cards.append(
            f'<div class="card" style="--color: var(--policy-{k})"><h4>{html.escape(policy)}</h4>'
            f'<div class="big">{100 * explored.iqm:.1f} %</div><div>explored</div><div>{html.escape(when)}</div>'
            f"<div>in {reached} of {explored.n} episodes</div></div>"
        )
    return f'<div class="cards">{"".join(cards)}</div>'


def _endings_table(rows: Sequence[Row], policies: Sequence[str]) -> Table:
    """Say for every policy why its episodes ended, and how much was left when they did not reach their target."""
    lines = []
    for policy in policies:
        mine = [row for row in rows if row["policy"] == policy]
        reasons = Counter(row["end_reason"].replace("_", " ") for row in mine).most_common()
        left = [row["area_left"] for row in mine if not row["success"]]
        counts = ", ".join(f"{reason}: {count}" for reason, count in reasons)
        lines.append([Cell(short(policy)), Cell(counts), Cell(f"{np.mean(left):.1f} m²" if left else "none")])
    return Table(("", "episodes", "left unexplored, on average, when not covered"), lines, words=(1,))


def _color_variables(theme: Theme, policies: Sequence[str]) -> str:
    colors = theme.colors(policies)
    return " ".join(f"--policy-{k}: {colors[policy]};" for k, policy in enumerate(policies))

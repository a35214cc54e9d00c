"""The report of an evaluation: one HTML file that needs nothing else."""

import html
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from string import Template

import numpy as np

from benchmarks.arena.measures import BY_NAME, MEASURES
from benchmarks.arena.page import Section, data_url, figure_element, html_table, themed, to_html
from benchmarks.arena.plots import WorldPictures
from benchmarks.arena.records import Row
from benchmarks.arena.settings import Settings
from benchmarks.arena.statistics import Estimate
from benchmarks.arena.summary import Comparison, best_of, compare, split, summarise
from benchmarks.arena.theme import DARK, LIGHT, Theme, short

Estimates = Mapping[str, Mapping[str, Estimate]]
"""Estimates by policy and measure."""

TIME = BY_NAME["time_to_95"]
"""What the cards show."""
_TEMPLATE = Path(__file__).with_name("report.html")
_GROWTH_CAPTION = "The same start for all. Colours: when a cell became known. Red: the true walls."


def build_report(
    rows: Sequence[Row],
    settings: Settings,
    pictures: Mapping[str, WorldPictures],
    leaderboard: Sequence[Section] = (),
    title: str = "How well do they explore?",
    intro: str = "",
    lead: Mapping[str, bytes] = {},
) -> str:
    """Return the report as HTML.

    Args:
        rows: all episodes.
        settings: what was run.
        pictures: of each case that is to have a section.
        leaderboard: stands above those.
        title: heading.
        intro: paragraph under the heading.
        lead: further pictures to show above the results: contents of PNG or GIF files by caption.
    """
    summary = summarise(rows)
    policies = list(summary)
    figures = "".join(figure_element(data_url(content), caption) for caption, content in lead.items())
    worlds = [to_html(leaderboard)]
    for case, here in split(rows).items():
        if case in pictures:
            estimates = {policy: summary[policy][case] for policy in policies if case in summary[policy]}
            worlds.append(_case(case, here, estimates, pictures[case]))
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


def _case(case: str, rows: Sequence[Row], estimates: Estimates, pictures: WorldPictures) -> str:
    """Return the section of a case, from its rows."""
    seed = rows[0]["seed"]
    first_rows: dict[str, Row] = {}
    for row in rows:
        first_rows.setdefault(row["policy"], row)
    maps = "".join(
        themed(picture, f"{policy}: {_story(first_rows[policy], seed)}") for policy, picture in pictures.maps.items()
    )
    return f"""<h2>{html.escape(case)}</h2>
{_cards(estimates, rows)}
<h3>Explored over time and distance</h3>
<div class="pair">
{themed(pictures.over_time, "Over time. Bands are 95 % intervals.")}
{themed(pictures.over_distance, "Over the distance driven.")}
</div>
<h3>All measures</h3>
{_table(estimates)}
<h3>Pair by pair</h3>
{_comparison_table(compare(rows))}
<h3>How the episodes ended</h3>
{_endings(rows, list(estimates))}
<h3>How the maps grew (seed {seed})</h3>
{themed(pictures.growth, _GROWTH_CAPTION, "wide")}
<h3>Final maps (seed {seed})</h3>
<div class="maps">{maps}</div>
"""


def _story(row: Row, usual_seed: int) -> str:
    """Say in a line how an episode went, and from where if not from the usual start."""
    left = "" if row["success"] else f", {row['area_left']:.1f} m² left"
    other = "" if row["seed"] == usual_seed else f"seed {row['seed']}: "
    return other + (
        f"{100 * row['explored_fraction']:.1f} % in {row['duration']:.0f} s and {row['path_length']:.0f} m"
        f" ({row['end_reason'].replace('_', ' ')}{left}), map IoU {100 * row['map_iou']:.0f} %"
    )


def _cards(estimates: Estimates, rows: Sequence[Row]) -> str:
    cards = []
    for k, (policy, values) in enumerate(estimates.items()):
        explored, time = values["explored_fraction"], values["time_to_95"]
        reached = sum(row["explored_fraction"] >= 0.95 for row in rows if row["policy"] == policy)
        when = f"95 % after {TIME.texts(time)[0]} s" if reached else "95 % never"
        cards.append(
            f'<div class="card" style="--color: var(--policy-{k})"><h4>{html.escape(policy)}</h4>'
            f'<div class="big">{100 * explored.iqm:.1f} %</div><div>explored</div><div>{when}</div>'
            f"<div>in {reached} of {explored.n} episodes</div></div>"
        )
    return f'<div class="cards">{"".join(cards)}</div>'


def _table(estimates: Estimates) -> str:
    """Lay out estimates with a row per measure and a column per policy."""
    lines = []
    for measure in MEASURES:
        row = {
            policy: by_measure[measure.name] for policy, by_measure in estimates.items() if measure.name in by_measure
        }
        if not row:
            continue
        best = best_of(row, measure)
        cells = ""
        for policy, value in row.items():
            middle, interval = map(html.escape, measure.texts(value))
            cells += f"<td{' class=best' if policy in best else ''}>{middle}<small>{interval}</small></td>"
        lines.append(f"<tr><th>{measure.label} <small class=muted>{measure.unit}</small></th>{cells}</tr>")
    return html_table(["", *(_dotted(k, policy) for k, policy in enumerate(estimates))], lines)


def _comparison_table(comparisons: Sequence[Comparison]) -> str:
    if not comparisons:
        return '<p class="muted">One policy alone has nobody to be compared with.</p>'
    lines = []
    for c in comparisons:
        (middle, interval), p = c.measure.texts(c.difference, "+"), c.improvement
        lines.append(
            f"<tr><th>{html.escape(short(c.policy))}</th><td>{c.measure.label}</td>"
            f"<td>{middle} {c.measure.unit}<small>{interval}</small></td>"
            f"<td>{100 * p.iqm:.0f} %<small>{100 * p.low:.0f} to {100 * p.high:.0f}</small></td></tr>"
        )
    reference = html.escape(short(comparisons[0].reference))
    return html_table(["", "measure", f"difference to {reference}", f"better than {reference}"], lines)


def _endings(rows: Sequence[Row], policies: Sequence[str]) -> str:
    """Say for every policy why its episodes ended, and how much was left when they did not end covered."""
    lines = []
    for k, policy in enumerate(policies):
        mine = [row for row in rows if row["policy"] == policy]
        reasons = Counter(row["end_reason"].replace("_", " ") for row in mine)
        left = [row["area_left"] for row in mine if not row["success"]]
        lines.append(
            f"<tr><th>{_dotted(k, policy)}</th>"
            f"<td>{html.escape(', '.join(f'{reason}: {count}' for reason, count in reasons.most_common()))}</td>"
            f"<td>{f'{np.mean(left):.1f} m²' if left else 'none'}</td></tr>"
        )
    return html_table(["", "episodes", "left unexplored, on average, when not covered"], lines)


def _dotted(number: int, policy: str) -> str:
    return f'<span class="dot" style="--color: var(--policy-{number})"></span>{html.escape(short(policy))}'


def _color_variables(theme: Theme, policies: Sequence[str]) -> str:
    colors = theme.colors(policies)
    return " ".join(f"--policy-{k}: {colors[policy]};" for k, policy in enumerate(policies))

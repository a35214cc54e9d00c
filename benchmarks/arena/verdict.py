"""What an evaluation says, in a sentence and in a picture: who explores fastest, and by how much."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing

from baselines import EXPLORERS
from benchmarks.arena.measures import BY_NAME
from benchmarks.arena.page import Figure, Section
from benchmarks.arena.pairs import bound_of, held_out, paired_values, policies_of, pool, reference_of
from benchmarks.arena.records import Row
from benchmarks.arena.statistics import Estimate, paired_difference
from benchmarks.arena.summary import PRIMARY, by_relative_time, rank
from benchmarks.arena.theme import LIGHT, Picture, Theme, short

TIME = BY_NAME["relative_time"]
NUM_NAMED = 3
"""Explorers that the sentence names where many cannot be told apart."""
MAX_SHARE = 1.6
"""Explorers that need more than this share of the reference's time are shown at the edge of the picture."""


def verdict_section(rows: Sequence[Row]) -> Section | None:
    """Return who explores fastest: where something learned takes part, first in what no training saw, then in all.

    Args:
        rows: related episodes (`benchmarks.arena.pairs.relate`) from starts that all competitors share.

    Returns:
        The section; None with fewer than two competitors.
    """
    if len(by_relative_time(rows)) < 2:
        return None
    text, where = verdict(rows), ""
    if unseen := held_out(rows):
        where = ", in worlds or with robots that no training of the package saw"
        text = f"{where[2:].capitalize()}: {verdict(unseen)} With those of the training: {text}"
        rows = unseen
    times = by_relative_time(rows)
    first = next(iter(times.values()))
    if first.never == first.n:
        return Section("At a glance", (text,))
    reference = reference_of(policies_of(rows))
    bound = bound_of(row["policy"] for row in rows if TIME.column in row)
    limits = {bound: pool(rows, bound, TIME)} if bound else {}
    draw = partial(draw_times, times, reference, (next(iter(times)), *_tied(rows, times)), limits)
    caption = (
        f"Time to 95 % as a share of {short(reference)}'s from the same start{where}: interquartile means, "
        "95 % intervals. Further left is faster. Blue: the fastest, and those that cannot be told apart from it."
    )
    return Section("At a glance", (text, Figure("verdict", Picture.of(draw), caption, is_wide=True)))


def verdict(rows: Sequence[Row]) -> str:
    """Say who explores fastest, by how much, who cannot be told apart from it, and what the bound is.

    Two explorers are told apart where the 95 % interval of their paired difference in relative time leaves out zero.

    Args:
        rows: related episodes of at least two competitors, from starts that all of them share.
    """
    times = by_relative_time(rows)
    leader, *others = times
    reference = reference_of(policies_of(rows))
    number = times[leader].n
    if times[leader].never == number:
        return f"No explorer explored 95 % from any of the {number} starts within the time limit."
    share = f"95 % in {_share(times[leader])} of {short(reference)}'s time over {number} starts"
    if leader == reference:
        share = f"no other needs less than its time to 95 % over {number} starts"
    if tied := _tied(rows, times):
        names = [f"{short(policy)} ({_share(times[policy])})" for policy in tied[:NUM_NAMED]]
        names += [f"{len(tied) - NUM_NAMED} more"] if len(tied) > NUM_NAMED else []
        parts = [f"{short(leader)} is ahead: {share}", f"it cannot be told apart from {_listed(names)}"]
    else:
        parts = [f"{short(leader)} explores fastest: {share}"]
    rivals = [policy for policy in others if leader in EXPLORERS or policy in EXPLORERS]
    if rivals and not set(rivals) & set(tied):
        who = "the next" if leader in EXPLORERS else "the best classic explorer"
        parts.append(f"{who}, {short(rivals[0])}, needs {_share(times[rivals[0]])}")
    if bound := bound_of(row["policy"] for row in rows if TIME.column in row):
        parts.append(f"the bound, {bound}, is {_share(pool(rows, bound, TIME))}")
    text = f"{'; '.join(parts)}."
    if (first := rank(rows)[0]) != leader:
        text += f" By {PRIMARY.label}, which the leaderboard is ranked by, {short(first)} comes first."
    return text


def _tied(rows: Sequence[Row], times: Mapping[str, Estimate]) -> list[str]:
    """Return those that cannot be told apart from the fastest explorer, fastest first."""
    leader, *others = times
    slower = {policy: paired_difference(*paired_values(rows, policy, leader, TIME)).low for policy in others}
    return [policy for policy in others if slower[policy] <= 0.0]


def _share(estimate: Estimate) -> str:
    """Return a share of the reference's time and its interval, such as "0.87 [0.84, 0.91]"."""
    middle, note = TIME.texts(estimate)
    if estimate.low == estimate.high:
        return middle
    return f"{middle} [{note.replace(' to ', ', ')}]" if " to " in note else f"{middle} ({note})"


def _listed(names: Sequence[str]) -> str:
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last


def draw_times(
    times: Mapping[str, Estimate],
    reference: str,
    marked: Sequence[str],
    bounds: Mapping[str, Estimate] = {},
    theme: Theme = LIGHT,
) -> Drawing:
    """Draw a dot with its interval for every explorer, fastest at the top, and the bound as a dashed line.

    Args:
        times: shares of the reference's time to 95 %, fastest first.
        reference: whose time is 1.
        marked: policies in colour.
        bounds: what explorers that use ground truth need.
        theme: colours.
    """
    figure = Drawing(figsize=(7.0, 0.9 + 0.27 * len(times)), dpi=160, layout="constrained", facecolor=theme.paper)
    axes = figure.subplots()
    inside = [value for value in times.values() if value.iqm <= MAX_SHARE]
    shown = [*inside, *bounds.values()]
    right = min(max(1.05, *(value.high for value in shown)) + 0.05, MAX_SHARE + 0.1)
    left = min(1.0, *(value.low for value in shown)) - 0.05
    axes.set(xlim=(left, right), ylim=(len(times) - 0.5, -0.6), facecolor=theme.paper)
    axes.axvline(1.0, color=theme.muted, linewidth=1.0, zorder=1)
    for bound in bounds.values():
        axes.axvline(bound.iqm, color=theme.ink, linewidth=1.2, linestyle=(0, (4, 3)), zorder=1)
    for k, (policy, value) in enumerate(times.items()):
        color = theme.lines[0] if policy in marked else theme.muted
        if value.iqm > right:
            axes.plot(right, k, marker=">", color=color, markersize=6, clip_on=False)
        else:
            axes.plot((value.low, min(value.high, right)), (k, k), color=color, linewidth=2.2, solid_capstyle="butt")
            axes.plot(value.iqm, k, marker="o", color=color, markersize=6.5)
    _label(axes, times, reference, marked, bounds, theme)
    return figure


def _label(
    axes: Axes,
    times: Mapping[str, Estimate],
    reference: str,
    marked: Sequence[str],
    bounds: Mapping[str, Estimate],
    theme: Theme,
) -> None:
    """Write the explorers at the left, their numbers at the right, and what the lines are above them."""
    axes.set_yticks(range(len(times)), list(map(short, times)), fontsize=9.5)
    for k, (policy, label) in enumerate(zip(times, axes.get_yticklabels())):
        weight = "bold" if policy in marked else "normal"
        label.set(color=theme.ink, fontweight=weight)
        text = "1" if policy == reference else _share(times[policy])
        place: dict[str, Any] = {
            "xy": (1.03, k),
            "xycoords": ("axes fraction", "data"),
            "va": "center",
            "annotation_clip": False,
        }
        axes.annotate(text, **place, color=theme.ink, fontsize=9.5, fontweight=weight)
    lines = [(1.0, f"{short(reference)} = 1")]
    lines += [(value.iqm, f"ground truth: {TIME.texts(value)[0]}") for value in bounds.values()]
    for (x, text), side in zip(sorted(lines, reverse=True), ("left", "right")):
        shift = 3 if side == "left" else -3
        # Side by side above the axes, away from each other; a bound near the left edge gets its name at its right.
        inner = len(lines) > 1 and side == "right" and lines[0][0] - x > 0.25
        where: dict[str, Any] = {"xy": (x, 1.0), "xycoords": axes.get_xaxis_transform(), "textcoords": "offset points"}
        offset = (-3 if inner else shift, 4)
        axes.annotate(text, **where, xytext=offset, ha="left" if inner else side, color=theme.ink, fontsize=9)
    axes.tick_params(axis="x", colors=theme.muted, labelcolor=theme.ink, labelsize=9)
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="x", color=theme.muted, alpha=0.2, linewidth=0.6)
    axes.set_xlabel(f"time to 95 %, as a share of {short(reference)}'s", color=theme.ink, fontsize=9.5)
    for side, spine in axes.spines.items():
        spine.set_visible(side == "bottom")
        spine.set_color(theme.muted)

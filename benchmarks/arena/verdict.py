"""What an evaluation says, in a sentence and in a picture: who does best, and by how much."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing

from baselines import CLASSIC
from benchmarks.arena.measures import MARK, Measures, texts
from benchmarks.arena.page import Figure, Section
from benchmarks.arena.pairs import bound_of, held_out, paired_values, policies_of, pool, reference_of
from benchmarks.arena.records import Row
from benchmarks.arena.statistics import Estimate, paired_difference
from benchmarks.arena.summary import competitors, standing
from benchmarks.arena.theme import LIGHT, Picture, Theme, short
from envs.measures import Measure

NUM_NAMED = 3
"""Policies that the sentence names where many cannot be told apart."""
MAX_SHARE = 1.6
"""Policies that need more than this share of the reference's time are shown at the edge of the picture."""


def verdict_section(rows: Sequence[Row], measures: Measures) -> Section | None:
    """Return who does best: where something learned takes part, first in what no training saw, then in all.

    Args:
        rows: related episodes (`benchmarks.arena.pairs.relate`) from starts that all competitors share.
        measures: of the task.

    Returns:
        The section; None with fewer than two competitors.
    """
    measure = measures.decisive
    if len(competitors(rows, measure)) < 2:
        return None
    text, where = verdict(rows, measures), ""
    if unseen := held_out(rows):
        where = ", in worlds or with robots that no training of the package saw"
        text = f"{where[2:].capitalize()}: {verdict(unseen, measures)} With those of the training: {text}"
        rows = unseen
    values = competitors(rows, measure)
    first = next(iter(values.values()))
    if first.never == first.n:
        return Section("At a glance", (text,))
    reference = reference_of(policies_of(rows))
    bound = bound_of(row["policy"] for row in rows if measure.name in row)
    limits = {bound: pool(rows, bound, measure)} if bound else {}
    marked = next(iter(values)), *_tied(rows, values, measure)
    what, side = f"{measure.label} [{measure.unit}]{where}", "right" if measure.higher_is_better else "left"
    best = "best"
    if measures.marks:
        what, best = f"{_relative_title(reference, measures)} from the same start{where}", "fastest"
    caption = (
        f"{what[:1].upper()}{what[1:]}: interquartile means, 95 % intervals. Further {side} is "
        f"{'faster' if measures.marks else 'better'}. Blue: the {best}, and those that cannot be told apart from it."
    )
    draw = partial(draw_values, values, reference, marked, limits, measures)
    return Section("At a glance", (text, Figure("verdict", Picture.of(draw), caption, is_wide=True)))


def _relative_title(reference: str, measures: Measures) -> str:
    return f"{measures.marks[0].label} as a share of {short(reference)}'s"


def verdict(rows: Sequence[Row], measures: Measures) -> str:
    """Say who does best, by how much, who cannot be told apart from it, and what the bound is.

    Two policies are told apart where the 95 % interval of their paired difference leaves out zero: in relative time to
    the first mark where the task has one, otherwise in its headline.

    Args:
        rows: related episodes of at least two competitors, from starts that all of them share.
        measures: of the task.
    """
    measure, reference = measures.decisive, reference_of(policies_of(rows))
    values = competitors(rows, measure)
    leader, *others = values
    number, mark = values[leader].n, next((mark.label.removeprefix(MARK) for mark in measures.marks), "")
    if mark and values[leader].never == number:
        return f"No policy reached {mark} from any of the {number} starts within the time limit."
    best, has = ("is fastest", "needs") if mark else ("does best", "has")
    found = f"{measure.label} {_value(values[leader], measure)} over {number} starts"
    if mark:
        found = f"{mark} in {_value(values[leader], measure)} of {short(reference)}'s time over {number} starts"
    if mark and leader == reference:
        found = f"no other needs less than its time to {mark} over {number} starts"
    if tied := _tied(rows, values, measure):
        names = [f"{short(policy)} ({_value(values[policy], measure)})" for policy in tied[:NUM_NAMED]]
        names += [f"{len(tied) - NUM_NAMED} more"] if len(tied) > NUM_NAMED else []
        parts = [f"{short(leader)} is ahead: {found}", f"it cannot be told apart from {_listed(names)}"]
    else:
        parts = [f"{short(leader)} {best}: {found}"]
    rivals = [policy for policy in others if leader in CLASSIC or policy in CLASSIC]
    if rivals and not set(rivals) & set(tied):
        who = "the next" if leader in CLASSIC else "the best classic policy"
        parts.append(f"{who}, {short(rivals[0])}, {has} {_value(values[rivals[0]], measure)}")
    if bound := bound_of(row["policy"] for row in rows if measure.name in row):
        parts.append(f"the bound, {bound}, is {_value(pool(rows, bound, measure), measure)}")
    text = f"{'; '.join(parts)}."
    if (first := next(iter(standing(rows, measures.headline)))) != leader:
        text += f" By {measures.headline.label}, which the leaderboard is ranked by, {short(first)} comes first."
    return text


def _tied(rows: Sequence[Row], values: Mapping[str, Estimate], measure: Measure) -> list[str]:
    """Return those that cannot be told apart from the best policy, best first."""
    leader, *others = values
    gaps = {policy: paired_difference(*paired_values(rows, policy, leader, measure)) for policy in others}
    if measure.higher_is_better:
        return [policy for policy in others if gaps[policy].high >= 0.0]
    return [policy for policy in others if gaps[policy].low <= 0.0]


def _value(estimate: Estimate, measure: Measure) -> str:
    """Return a value and its interval, such as "0.87 [0.84, 0.91]"."""
    middle, note = texts(measure, estimate)
    middle = f"{middle} {measure.unit}".strip()
    if estimate.low == estimate.high:
        return middle
    return f"{middle} [{note.replace(' to ', ', ')}]" if " to " in note else f"{middle} ({note})"


def _listed(names: Sequence[str]) -> str:
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last


def draw_values(
    values: Mapping[str, Estimate],
    reference: str,
    marked: Sequence[str],
    bounds: Mapping[str, Estimate],
    measures: Measures,
    theme: Theme = LIGHT,
) -> Drawing:
    """Draw a dot with its interval for every policy, the best at the top, and the bound as a dashed line.

    Args:
        values: of `Measures.decisive`, best first.
        reference: whose time is 1, where times are compared as shares.
        marked: policies in colour.
        bounds: values of policies that use ground truth.
        measures: of the task.
        theme: colours.
    """
    figure = Drawing(figsize=(7.0, 0.9 + 0.27 * len(values)), dpi=160, layout="constrained", facecolor=theme.paper)
    axes, scale = figure.subplots(), measures.decisive.scale
    left, right = _limits([*values.values(), *bounds.values()], scale, bool(measures.marks))
    axes.set(xlim=(left, right), ylim=(len(values) - 0.5, -0.6), facecolor=theme.paper)
    if measures.marks:
        axes.axvline(1.0, color=theme.muted, linewidth=1.0, zorder=1)
    for bound in bounds.values():
        axes.axvline(scale * bound.iqm, color=theme.ink, linewidth=1.2, linestyle=(0, (4, 3)), zorder=1)
    for k, (policy, value) in enumerate(values.items()):
        color = theme.lines[0] if policy in marked else theme.muted
        middle, low, high = (scale * number for number in value[:3])
        if middle > right:
            axes.plot(right, k, marker=">", color=color, markersize=6, clip_on=False)
        else:
            axes.plot((low, min(high, right)), (k, k), color=color, linewidth=2.2, solid_capstyle="butt")
            axes.plot(middle, k, marker="o", color=color, markersize=6.5)
    _label(axes, values, reference, marked, bounds, measures, theme)
    return figure


def _limits(values: Sequence[Estimate], scale: float, are_shares: bool) -> tuple[float, float]:
    """Return the ends of the axis; shares of the reference's time always show it, and no more than `MAX_SHARE`."""
    if not are_shares:
        low, high = scale * min(value.low for value in values), scale * max(value.high for value in values)
        margin = 0.05 * max(high - low, 1e-3)
        return low - margin, high + margin
    inside = [value for value in values if value.iqm <= MAX_SHARE]
    right = min(max(1.05, *(value.high for value in inside)) + 0.05, MAX_SHARE + 0.1)
    return min(1.0, *(value.low for value in inside)) - 0.05, right


def _label(
    axes: Axes,
    values: Mapping[str, Estimate],
    reference: str,
    marked: Sequence[str],
    bounds: Mapping[str, Estimate],
    measures: Measures,
    theme: Theme,
) -> None:
    """Write the policies at the left, their numbers at the right, and what the lines are above them."""
    measure = measures.decisive
    axes.set_yticks(range(len(values)), list(map(short, values)), fontsize=9.5)
    for k, (policy, label) in enumerate(zip(values, axes.get_yticklabels())):
        weight = "bold" if policy in marked else "normal"
        label.set(color=theme.ink, fontweight=weight)
        text = "1" if measures.marks and policy == reference else _value(values[policy], measure)
        place: dict[str, Any] = {
            "xy": (1.03, k),
            "xycoords": ("axes fraction", "data"),
            "va": "center",
            "annotation_clip": False,
        }
        axes.annotate(text, **place, color=theme.ink, fontsize=9.5, fontweight=weight)
    lines = [(1.0, f"{short(reference)} = 1")] if measures.marks else []
    lines += [(measure.scale * value.iqm, f"ground truth: {texts(measure, value)[0]}") for value in bounds.values()]
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
    title = _relative_title(reference, measures) if measures.marks else measure.title
    axes.set_xlabel(title, color=theme.ink, fontsize=9.5)
    for side, spine in axes.spines.items():
        spine.set_visible(side == "bottom")
        spine.set_color(theme.muted)

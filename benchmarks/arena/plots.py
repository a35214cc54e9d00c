"""Plotting functions for evaluations: curves, comparisons of policies, and maps."""

import io
import textwrap
from collections.abc import Callable, Mapping, Sequence
from itertools import cycle, product
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from matplotlib.transforms import Affine2D
from PIL import Image

from lidarnaut.agents.policy_names import is_bound, short
from lidarnaut.agents.statistics import Band, Estimate, curve_band
from lidarnaut.benchmarks.arena.trace import ProgressCurve, Trace
from lidarnaut.envs.rendering import style


def hex_color(color: style.Colour) -> str:
    """Return a color of the renderer for Matplotlib."""
    return "#{:02x}{:02x}{:02x}".format(*color)


PAPER, INK, MUTED = "#ffffff", hex_color(style.INK), hex_color(style.MUTED)
UNKNOWN, ERROR, PERSON = "#e7e9ed", "#d43d2a", hex_color(style.PERSON)
GOAL = hex_color(style.FRONTIER)
LINES = (*map(hex_color, (style.TRUE, style.ESTIMATED)), GOAL, hex_color(style.LOOP), "#d69400", "#42a5e0")
"""Line colours of policies; if there are more policies, colours repeat with the next line style."""
DASHES = ("solid", (0, (5.0, 1.2)), (0, (6.0, 1.5, 1.5, 1.5)))
TIMES = LinearSegmentedColormap.from_list("times", ("#fdf0c3", "#b9dfb4", "#63b6bd", "#4a7fb8"))
STYLE: dict[Any, Any] = {
    "axes.edgecolor": MUTED,
    "axes.grid": True,
    "axes.labelcolor": INK,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "figure.constrained_layout.use": True,
    "figure.dpi": 160,
    "grid.alpha": 0.25,
    "grid.color": MUTED,
    "grid.linewidth": 0.6,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "text.color": INK,
    "xtick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.color": MUTED,
    "ytick.labelcolor": INK,
}
NUM_COLORS = 128
NUM_POINTS = 200
MAX_NAME = 24
"""Maximum number of characters in a line of a policy's name."""
MAX_SHARE = 1.6
"""Upper end of the axis for times relative to the reference policy. Slower policies are drawn at the edge."""

NUM_MOMENTS, MAP_WIDTH = 4, 2.4
"""Number of maps in a figure of an episode, and the width of each [inch]."""
Bands = Mapping[str, Band]


def render(draw: Callable[..., Figure], *arguments: Any) -> bytes:
    """Return the figure that `draw(*arguments)` creates, as the content of a PNG file."""
    buffer, small = io.BytesIO(), io.BytesIO()
    with matplotlib.rc_context(STYLE):
        draw(*arguments).savefig(buffer, format="png")
    image = Image.open(buffer).convert("RGB").quantize(NUM_COLORS, dither=Image.Dither.NONE)
    image.save(small, format="png", optimize=True)
    return small.getvalue()


def sample_curves(
    curves: Mapping[str, Sequence[Sequence[ProgressCurve]]], over: str, end: float | None = None
) -> tuple[np.ndarray, Bands]:
    """Average progress curves over time or distance; return the x values and a curve with 95 % interval per policy.

    `curves` has one list of curves per policy and world; `over` is `time` or `path_length`; `end` is the last x value,
    by default that of the longest episode. Ended episodes keep their last progress.
    """
    if end is None:
        end = max(float(getattr(c, over)[-1]) for strata in curves.values() for stratum in strata for c in stratum)
    grid = np.linspace(0.0, max(end, 1e-3), NUM_POINTS)
    return grid, {
        policy: curve_band([np.array([np.interp(grid, getattr(c, over), c.progress) for c in one]) for one in strata])
        for policy, strata in curves.items()
    }


def draw_bands(grid: np.ndarray, bands: Bands, xlabel: str, ylabel: str) -> Figure:
    """Plot a curve in percent with its 95 % interval for each policy."""
    names = {policy: wrapped(policy) for policy in bands}
    figure = Figure(figsize=(6.6, max(3.6, 0.9 + 0.15 * sum(1 + name.count("\n") for name in names.values()))))
    axes, lines, alpha = figure.subplots(), list[Line2D](), 0.18 if len(bands) <= 4 else 0.09
    looks = ({"color": color, "linestyle": dash} for dash, color in cycle(product(DASHES, LINES)))
    others: dict[str, Any] = {"random": {"color": MUTED}}
    for policy, band in bands.items():
        bound = {"color": INK, "linestyle": (0, (1.0, 1.2))} if is_bound(policy) else None
        look, (middle, low, high) = bound or others.get(policy) or next(looks), (100.0 * line for line in band)
        axes.fill_between(grid, low, high, color=look["color"], alpha=alpha, linewidth=0)
        lines += axes.plot(grid, middle, linewidth=1.8, label=names[policy], **look)
    axes.set(xlim=(float(grid[0]), float(grid[-1])), ylim=(0.0, 102.0), xlabel=xlabel, ylabel=f"{ylabel} [%]")
    lines.sort(key=lambda line: -np.mean(np.asarray(line.get_ydata(), np.float64)))
    figure.legend(handles=lines, loc="outside right center", handlelength=2.4)
    return figure


def wrapped(policy: str, width: int = MAX_NAME) -> str:
    """Return the short name of a policy in lines of at most `width` characters."""
    lines = textwrap.wrap(short(policy).replace("_", "_ "), width)
    return "\n".join(line.replace("_ ", "_") for line in lines)


def draw_values(
    values: Mapping[str, tuple[Estimate, str]],
    marked: Sequence[str],
    levels: Mapping[str, float],
    title: str,
    are_shares: bool,
) -> Figure:
    """Plot each policy's estimate and 95 % interval in a row, with a text on the right.

    `marked` policies are coloured. `levels`: labelled vertical lines. `are_shares`: values are relative to the
    reference policy, and the axis ends at `MAX_SHARE`.
    """
    names = [wrapped(policy) for policy in values]
    figure = Figure(figsize=(7.0, 1.2 + sum(0.27 + 0.13 * name.count("\n") for name in names)))
    axes = figure.subplots()
    shown = [one for one, _ in values.values() if not are_shares or one.iqm <= MAX_SHARE]
    low, high = min([one.low for one in shown] + [*levels.values()]), max(one.high for one in shown)
    high = min(high, MAX_SHARE) if are_shares else high
    margin = 0.05 * max(high - low, 1e-3)
    for level, (label, where) in enumerate(levels.items()):
        axes.axvline(where, color=INK, linewidth=1.1, linestyle=DASHES[level], label=label)
    for k, (policy, (value, _)) in enumerate(values.items()):
        color = LINES[0] if policy in marked else MUTED
        if value in shown:
            axes.plot((value.low, min(value.high, high + margin)), (k, k), color=color, linewidth=2.2)
            axes.plot(value.iqm, k, marker="o", color=color, markersize=6.5)
        else:
            axes.plot(high, k, marker=">", color=color, markersize=6)
    axes.set(xlim=(low - margin, high + margin), ylim=(len(values) - 0.5, -0.6), xlabel=title)
    axes.grid(axis="y", visible=False)
    axes.spines["left"].set_visible(False)
    beside = axes.secondary_yaxis("right")
    beside.spines["right"].set_visible(False)
    texts = [text for _, text in values.values()]
    for side, labels in ((axes, names), (beside, texts)):
        side.set_yticks(range(len(values)), labels)
        side.tick_params(axis="y", length=0)
        for policy, tick in zip(values, side.get_yticklabels()):
            tick.set_fontweight("bold" if policy in marked else "normal")
    if levels:
        figure.legend(loc="outside upper center", ncols=len(levels))
    return figure


def draw_growth(policy: str, trace: Trace) -> Figure:
    """Plot a map at `NUM_MOMENTS` times, the last one at the end of the episode, with the people there.

    Free cells are coloured by the time of first observation, unless the map was given, and overlaid with true walls.
    """
    shapes = np.concatenate((trace.segments.reshape(-1, 2), trace.circles[:, :2]))
    (x_min, y_min), (x_max, y_max) = (shapes.min(axis=0) - 0.3).tolist(), (shapes.max(axis=0) + 0.3).tolist()
    height = min(max((y_max - y_min) / (x_max - x_min), 0.4), 2.0) * MAP_WIDTH
    figure = Figure(figsize=(NUM_MOMENTS * MAP_WIDTH + 0.8, height + 0.3), dpi=110)
    row, end = figure.subplots(1, NUM_MOMENTS), float(trace.curve.time[-1])
    for axes, moment in zip(row, end * np.geomspace(1 / 8, 1.0, NUM_MOMENTS)):
        draw_map(axes, trace, moment)
        share = float(np.interp(moment, trace.curve.time, trace.curve.progress))
        axes.set(xlim=(x_min, x_max), ylim=(y_min, y_max), aspect="equal", xticks=[], yticks=[], facecolor=UNKNOWN)
        axes.set_title(f"{'end, ' if moment == end else ''}{moment:.0f} s: {100 * share:.0f} %", fontsize=9, pad=3)
        for spine in axes.spines.values():
            spine.set_visible(False)
    people = [Circle((x, y), radius) for x, y, radius in trace.people]
    row[-1].add_collection(PatchCollection(people, facecolor=PERSON, edgecolor=PAPER, linewidth=0.6, zorder=3))
    row[0].set_ylabel(wrapped(policy, round(10 * height)), fontsize=10)
    if not trace.is_given:
        colors = ScalarMappable(Normalize(0.0, max(end, 1e-9)), TIMES)
        bar = figure.colorbar(colors, ax=row[-1], fraction=0.08, pad=0.03, ticks=[0.0, end], format="%.0f")
        bar.set_label("first observed [s]")
    return figure


def draw_map(axes: Axes, trace: Trace, moment: float) -> None:
    """Draw the map known at `moment` [s], with path, goal and true walls."""
    known = trace.known_since <= moment
    picture = np.full((*known.shape, 4), to_rgba(UNKNOWN), dtype=np.float32)
    since = trace.known_since[known] / max(float(trace.curve.time[-1]), 1e-9)
    picture[known] = to_rgba(PAPER) if trace.is_given else TIMES(since)
    picture[known & trace.grid.occupied] = to_rgba(INK)
    x_min, y_min, x_max, y_max = trace.grid.bounds
    image = axes.imshow(picture, origin="lower", extent=(x_min, x_max, y_min, y_max), interpolation="auto")
    image.set_transform(Affine2D().rotate(trace.start.theta).translate(*trace.start[:2]) + axes.transData)
    walls = list(trace.segments.reshape(-1, 2, 2))
    axes.add_collection(LineCollection(walls, colors=ERROR, linewidths=0.6, alpha=0.7))
    rings = [Circle((x, y), radius) for x, y, radius in trace.circles]
    axes.add_collection(PatchCollection(rings, facecolor="none", edgecolor=ERROR, linewidth=0.6, alpha=0.7))
    samples = int(np.searchsorted(trace.curve.time, moment, side="right"))
    trail = trace.start.transform(trace.trail[: max(samples, 1)])
    axes.plot(*trail.T, color=PAPER, linewidth=2.4, alpha=0.8)
    axes.plot(*trail.T, color=INK, linewidth=1.0)
    axes.plot(*trail[0], marker="o", markersize=4, color=PAPER, markeredgecolor=INK)
    axes.plot(*trail[-1], marker="o", markersize=4.5, color=ERROR, markeredgecolor=PAPER)
    goal = trace.start.transform(trace.goal)
    axes.plot(*goal, "o", markersize=8, fillstyle="none", markeredgecolor=GOAL, markeredgewidth=2.0)

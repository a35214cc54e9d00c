"""Curves and performance profiles with intervals, and maps as they grew and ended."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.colors import LinearSegmentedColormap, to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from matplotlib.transforms import Affine2D

from benchmarks.arena.statistics import Band, curve_band
from benchmarks.arena.theme import LIGHT, Theme, short
from benchmarks.arena.trace import Curve, Trace
from envs.geometry import OccupancyGrid, Pose2D

Extent = tuple[float, float, float, float]
"""(x_min, x_max, y_min, y_max), world frame [m]."""
NUM_POINTS = 200
"""Points at which curves are drawn."""


@dataclass(frozen=True, slots=True, eq=False)
class Bands:
    """Curves of several policies over a common grid, shape (points,)."""

    grid: np.ndarray
    by_policy: Mapping[str, Band]


def sample_curves(
    curves: Mapping[str, Sequence[Sequence[Curve]]],
    over: Literal["time", "path_length"],
    end: float | None = None,
) -> Bands:
    """Average the progress over each policy's episodes; one that has ended keeps its last value.

    Curves are given by policy and stratum, and sampled up to `end`; None takes the longest episode's end.
    """
    if end is None:
        end = max(float(getattr(c, over)[-1]) for strata in curves.values() for stratum in strata for c in stratum)
    grid = max(end, 1e-3) * np.linspace(0.0, 1.0, NUM_POINTS) ** 2
    bands = {}
    for policy, strata in curves.items():
        sampled = [
            np.array([np.interp(grid, getattr(curve, over), curve.progress) for curve in stratum]) for stratum in strata
        ]
        bands[policy] = curve_band(sampled)
    return Bands(grid, bands)


def draw_curves(bands: Bands, quantity: str, label: str, theme: Theme = LIGHT) -> Figure:
    """Draw the progress of each policy, called `label`, over a quantity, with its 95 % interval as a band."""
    figure, axes = _figure(theme)
    for mark in (90, 95, 99):
        axes.axhline(mark, color=theme.muted, linewidth=0.6, linestyle=(0, (2, 3)))
    _draw_bands(axes, bands, theme)
    end = float(bands.grid[-1])
    # Good explorers are done early and poor ones never: a linear axis would show a step and a plain.
    axes.set_xscale("function", functions=(np.sqrt, np.square))
    axes.set(xticks=_root_ticks(end), xlim=(0.0, end), ylim=(0.0, 102.0), yticks=[0, 25, 50, 75, 90, 100])
    axes.set_xlabel(f"{quantity}, square-root scale", color=theme.ink)
    axes.set_ylabel(f"{label} [%]", color=theme.ink)
    _legend(figure, axes, theme)
    return figure


def draw_profiles(bands: Bands, score: str, theme: Theme = LIGHT) -> Figure:
    """Draw each policy's performance profile over thresholds of a score, with its 95 % interval as a band."""
    figure, axes = _figure(theme)
    _draw_bands(axes, bands, theme)
    axes.set(xlim=(float(bands.grid[0]), float(bands.grid[-1])), ylim=(0.0, 102.0))
    axes.set_xlabel(score, color=theme.ink)
    axes.set_ylabel("share of episodes [%]", color=theme.ink)
    _legend(figure, axes, theme)
    return figure


def _figure(theme: Theme) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(6.6, 3.6), dpi=160, layout="constrained", facecolor=theme.paper)
    axes = figure.subplots()
    axes.set_facecolor(theme.paper)
    axes.tick_params(colors=theme.muted, labelcolor=theme.ink)
    axes.grid(color=theme.muted, alpha=0.25, linewidth=0.6)
    for side, spine in axes.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(theme.muted)
    return figure, axes


def _draw_bands(axes: Axes, bands: Bands, theme: Theme) -> None:
    """Draw curves as percentages."""
    colors, dashes = theme.colors(list(bands.by_policy)), theme.dashes(list(bands.by_policy))
    # So many bands over each other would hide each other.
    alpha = 0.18 if len(bands.by_policy) <= 4 else 0.09
    for policy, band in bands.by_policy.items():
        middle, low, high = (100.0 * line for line in band)
        axes.fill_between(bands.grid, low, high, color=colors[policy], alpha=alpha, linewidth=0)
        (line,) = axes.plot(bands.grid, middle, color=colors[policy], linewidth=1.8, label=short(policy))
        line.set_linestyle(dashes[policy])


def _legend(figure: Figure, axes: Axes, theme: Theme) -> None:
    """Put the legend beside the axes, where it covers nothing, in the order of the means of the curves."""
    lines, names = axes.get_legend_handles_labels()
    means = [np.asarray(line.get_ydata(), np.float64).mean() for line in lines if isinstance(line, Line2D)]
    order = sorted(range(len(lines)), key=lambda k: -means[k])
    figure.legend(
        [lines[k] for k in order],
        [names[k] for k in order],
        loc="outside right center",
        frameon=False,
        labelcolor=theme.ink,
        fontsize=8.5,
        handlelength=2.4,
    )


def _root_ticks(end: float) -> list[float]:
    """Return round numbers from 0 to `end` whose roots are spaced about evenly."""
    ticks = [0.0]
    for number in (m * 10.0**k for k in range(-1, 6) for m in (1, 2, 5)):
        if number <= end and np.sqrt(number) - np.sqrt(ticks[-1]) >= 0.11 * np.sqrt(end):
            ticks.append(number)
    return ticks


def draw_map(trace: Trace, theme: Theme = LIGHT) -> Figure:
    """Draw the final map of an episode over the true walls; free cells are coloured by when they became known."""
    extent = extent_of([trace])
    figure = _map_figure(1, 1, extent, 5.0, theme)
    axes = figure.subplots()
    _draw_map(axes, trace, float(trace.curve.time[-1]), float(trace.curve.time[-1]), extent, theme)
    return figure


def draw_growth(traces: Mapping[str, Trace], theme: Theme = LIGHT, num_moments: int = 4) -> Figure:
    """Draw how the maps of several policies, an episode each, grow from the same start: a row each.

    Columns are the same moments, from half the shortest episode (or earlier) to the end of the longest.
    """
    extent = extent_of(list(traces.values()))
    ends = [float(trace.curve.time[-1]) for trace in traces.values()]
    moments = np.geomspace(max(min(min(ends) / 2, max(ends) / 8), 0.1), max(ends), num_moments)
    figure = _map_figure(len(traces), num_moments, extent, 2.4, theme)
    for row, (policy, trace) in zip(figure.subplots(len(traces), num_moments, squeeze=False), traces.items()):
        shown_end = False
        for axes, moment in zip(row, moments):
            ended = moment >= trace.curve.time[-1]
            if shown_end:
                show_only(axes, extent, theme.paper)
                continue
            shown_end = ended
            moment = min(moment, trace.curve.time[-1])
            _draw_map(axes, trace, moment, max(ends), extent, theme)
            fraction = float(np.interp(moment, trace.curve.time, trace.curve.progress))
            title = f"{'end, ' if ended else ''}{moment:.0f} s: {100 * fraction:.0f} %"
            axes.set_title(title, color=theme.ink, fontsize=9, pad=3)
        row[0].set_ylabel(short(policy), color=theme.ink, fontsize=10)
    return figure


def extent_of(traces: Sequence[Trace]) -> Extent:
    """Return the extent of the true walls with a margin."""
    points = [trace.segments.reshape(-1, 2) for trace in traces] + [trace.circles[:, :2] for trace in traces]
    together = np.concatenate(points)
    (x_min, y_min), (x_max, y_max) = together.min(axis=0) - 0.3, together.max(axis=0) + 0.3
    return float(x_min), float(x_max), float(y_min), float(y_max)


def _map_figure(rows: int, cols: int, extent: Extent, width: float, theme: Theme) -> Figure:
    """Make a figure for maps that are `width` inches wide, and as high as the world asks for."""
    aspect = (extent[3] - extent[2]) / (extent[1] - extent[0])
    size = (cols * width + 0.3, rows * (min(max(aspect, 0.4), 2.0) * width + 0.3))
    return Figure(figsize=size, dpi=110, layout="constrained", facecolor=theme.paper)


def _draw_map(axes: Axes, trace: Trace, moment: float, end: float, extent: Extent, theme: Theme) -> None:
    """Draw what was known at a moment [s]; `end` is the time for the last colour [s]."""
    since, data = trace.known_since, trace.grid.data
    known = since <= moment
    ramp = LinearSegmentedColormap.from_list("times", theme.times)
    picture = np.full((*data.shape, 4), to_rgba(theme.unknown), dtype=np.float32)
    picture[known] = ramp(np.sqrt(since[known] / max(end, 1e-9)))
    picture[known & (data >= 50)] = to_rgba(theme.ink)
    show_map(axes, picture, trace.grid, trace.start, trace.segments, theme)
    rings = [Circle((x, y), radius) for x, y, radius in trace.circles]
    axes.add_collection(PatchCollection(rings, facecolor="none", edgecolor=theme.error, linewidth=0.6, alpha=0.7))
    samples = int(np.searchsorted(trace.curve.time, moment, side="right"))
    trail = trace.start.transform(trace.trail[: max(samples, 1)])
    axes.plot(*trail.T, color=theme.paper, linewidth=2.4, alpha=0.8)
    axes.plot(*trail.T, color=theme.ink, linewidth=1.0)
    axes.plot(*trail[0], marker="o", markersize=4, color=theme.paper, markeredgecolor=theme.ink)
    axes.plot(*trail[-1], marker="o", markersize=4.5, color=theme.error, markeredgecolor=theme.paper)
    show_only(axes, extent, theme.unknown)


def show_map(
    axes: Axes, picture: np.ndarray, grid: OccupancyGrid, start: Pose2D, segments: np.ndarray, theme: Theme
) -> None:
    """Show the picture of a map, shape (height, width, 4), where it lies in the world, and the true walls over it."""
    x_min, y_min, x_max, y_max = grid.bounds
    image = axes.imshow(picture, origin="lower", extent=(x_min, x_max, y_min, y_max), interpolation="auto")
    image.set_transform(Affine2D().rotate(start.theta).translate(start.x, start.y) + axes.transData)
    walls = LineCollection(list(segments.reshape(-1, 2, 2)), colors=theme.error, linewidths=0.6, alpha=0.7)
    axes.add_collection(walls)


def show_only(axes: Axes, extent: Extent, background: str) -> None:
    """Show nothing but what is drawn in `extent`, on a background."""
    axes.set(xlim=extent[:2], ylim=extent[2:], aspect="equal", xticks=[], yticks=[], facecolor=background)
    for spine in axes.spines.values():
        spine.set_visible(False)

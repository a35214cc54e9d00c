"""Pictures of an evaluation: curves with intervals, final maps, and maps as they grow."""

import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.colors import LinearSegmentedColormap, to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from matplotlib.transforms import Affine2D

from baselines.episode import Curve
from benchmarks.arena.statistics import curve_band
from benchmarks.arena.trace import Trace

NUM_POINTS = 200
"""Points at which curves are drawn."""


@dataclass(frozen=True, slots=True)
class Theme:
    """Colours of a picture on light or on dark paper."""

    paper: str
    """Background."""
    ink: str
    """Text and walls."""
    muted: str
    """Axes, grid, and the policy `random`, which is there for reference."""
    unknown: str
    """Map cells that were never seen."""
    error: str
    """True walls over the map."""
    lines: tuple[str, ...]
    """One per policy, in order; told apart also by readers who do not see all colours."""
    times: tuple[str, ...]
    """From the first cells seen to the last."""

    def colors(self, policies: Sequence[str]) -> dict[str, str]:
        """Give every policy its colour."""
        others = [policy for policy in policies if policy != "random"]
        colors = {policy: self.lines[k % len(self.lines)] for k, policy in enumerate(others)}
        return {policy: colors.get(policy, self.muted) for policy in policies}


LIGHT = Theme(
    paper="#ffffff",
    ink="#1d2129",
    muted="#7c838f",
    unknown="#e7e9ed",
    error="#d43d2a",
    lines=("#1668b8", "#d2600c", "#16865c", "#8a4fc4", "#a67c00", "#bf3f7f"),
    times=("#fdf0c3", "#b9dfb4", "#63b6bd", "#4a7fb8"),
)
DARK = Theme(
    paper="#16191f",
    ink="#e8eaee",
    muted="#8b93a1",
    unknown="#262b34",
    error="#ff7a66",
    lines=("#63adf2", "#f79a57", "#52cf9c", "#c39af2", "#e0bd4a", "#ee86b7"),
    times=("#8a7a3a", "#4f8058", "#2f7480", "#2f5487"),
)


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture on light and on dark paper."""

    light: bytes
    """Content of a PNG file."""
    dark: bytes
    """Content of a PNG file."""

    @classmethod
    def of(cls, draw: Callable[[Theme], Figure]) -> "Picture":
        """Draw twice."""
        return cls(_to_png(draw(LIGHT)), _to_png(draw(DARK)))


@dataclass(frozen=True, slots=True)
class WorldPictures:
    """What there is to see of an evaluation in one world."""

    over_time: Picture
    """The explored fraction over time."""
    over_distance: Picture
    """The explored fraction over the distance driven."""
    growth: Picture
    """How the maps of each policy's first episode grew."""
    maps: Mapping[str, Picture]
    """The final map of each policy's first episode."""


def draw_world(traces: Mapping[str, Sequence[Trace]]) -> WorldPictures:
    """Draw all pictures of the episodes in one world, given by policy."""
    curves = {policy: [trace.curve for trace in episodes] for policy, episodes in traces.items()}
    over_time, over_distance = sample_curves(curves, "time"), sample_curves(curves, "path_length")
    firsts = {policy: episodes[0] for policy, episodes in traces.items()}
    return WorldPictures(
        Picture.of(partial(draw_curves, over_time, "time [s]")),
        Picture.of(partial(draw_curves, over_distance, "distance driven [m]")),
        Picture.of(partial(draw_growth, firsts)),
        {policy: Picture.of(partial(draw_map, trace)) for policy, trace in firsts.items()},
    )


@dataclass(frozen=True, slots=True, eq=False)
class Bands:
    """Curves of several policies over a common grid."""

    grid: np.ndarray
    """Shape (points,), where the curves were sampled."""
    by_policy: Mapping[str, tuple[np.ndarray, np.ndarray, np.ndarray]]
    """Interquartile mean, and lower and upper end of its interval: shape (points,) each."""


def sample_curves(curves: Mapping[str, Sequence[Curve]], over: Literal["time", "path_length"]) -> Bands:
    """Average the explored fraction over each policy's episodes; one that has ended keeps its last value."""
    end = max(float(getattr(curve, over)[-1]) for episodes in curves.values() for curve in episodes)
    grid = max(end, 1e-3) * np.linspace(0.0, 1.0, NUM_POINTS) ** 2
    sampled = {
        policy: np.array([np.interp(grid, getattr(curve, over), curve.explored_fraction) for curve in episodes])
        for policy, episodes in curves.items()
    }
    return Bands(grid, {policy: curve_band(fractions) for policy, fractions in sampled.items()})


def draw_curves(bands: Bands, quantity: str, theme: Theme = LIGHT) -> Figure:
    """Draw the explored fraction of each policy, with its 95 % interval as a band.

    Args:
        bands: the curves.
        quantity: what runs along the x axis.
        theme: colours.
    """
    figure = Figure(figsize=(4.8, 3.3), dpi=200, layout="constrained", facecolor=theme.paper)
    axes = figure.subplots()
    _style(axes, theme)
    colors = theme.colors(list(bands.by_policy))
    for mark in (90, 95, 99):
        axes.axhline(mark, color=theme.muted, linewidth=0.6, linestyle=(0, (2, 3)))
    for policy, band in bands.by_policy.items():
        middle, low, high = (100.0 * line for line in band)
        axes.fill_between(bands.grid, low, high, color=colors[policy], alpha=0.18, linewidth=0)
        axes.plot(bands.grid, middle, color=colors[policy], linewidth=2.0, label=short(policy))
    end = float(bands.grid[-1])
    # Good explorers are done early and poor ones never: a linear axis would show a step and a plain.
    axes.set_xscale("function", functions=(np.sqrt, np.square))
    axes.set_xticks(_root_ticks(end))
    axes.set_xlim(0.0, end)
    axes.set_ylim(0.0, 102.0)
    axes.set_yticks([0, 25, 50, 75, 90, 100])
    axes.set_xlabel(f"{quantity}, square-root scale", color=theme.ink)
    axes.set_ylabel("explored [%]", color=theme.ink)
    legend = axes.legend(loc="lower right", frameon=False, labelcolor=theme.ink)
    legend.set_zorder(5)
    return figure


def draw_map(trace: Trace, theme: Theme = LIGHT) -> Figure:
    """Draw the final map of an episode over the true walls; free cells are coloured by when they became known."""
    extent = _extent([trace])
    figure = _map_figure(1, 1, extent, 5.0, theme)
    axes = figure.subplots()
    _draw_map(axes, trace, float(trace.curve.time[-1]), float(trace.curve.time[-1]), extent, theme)
    return figure


def draw_growth(traces: Mapping[str, Trace], theme: Theme = LIGHT, num_moments: int = 4) -> Figure:
    """Draw how the maps of several policies grow: a row each, at the same moments.

    Args:
        traces: an episode of each policy, with the same start.
        theme: colours.
        num_moments: columns, from half the shortest episode (or earlier) to the end of the longest.
    """
    extent = _extent(list(traces.values()))
    ends = [float(trace.curve.time[-1]) for trace in traces.values()]
    moments = np.geomspace(max(min(min(ends) / 2, max(ends) / 8), 0.1), max(ends), num_moments)
    figure = _map_figure(len(traces), num_moments, extent, 2.4, theme)
    for row, (policy, trace) in zip(figure.subplots(len(traces), num_moments, squeeze=False), traces.items()):
        shown_end = False
        for axes, moment in zip(row, moments):
            ended = moment >= trace.curve.time[-1]
            if shown_end:
                _clear(axes, extent, theme)
                continue
            shown_end = ended
            moment = min(moment, trace.curve.time[-1])
            _draw_map(axes, trace, moment, max(ends), extent, theme)
            fraction = float(np.interp(moment, trace.curve.time, trace.curve.explored_fraction))
            title = f"{'end, ' if ended else ''}{moment:.0f} s: {100 * fraction:.0f} %"
            axes.set_title(title, color=theme.ink, fontsize=9, pad=3)
        row[0].set_ylabel(short(policy), color=theme.ink, fontsize=10)
    return figure


def short(policy: str) -> str:
    """Return a policy's name for a legend: of `ppo:a/long/path` the kind and the last part."""
    kind, _, path = policy.partition(":")
    parts = [part for part in path.split("/") if part not in ("", "checkpoints")]
    return f"{kind} {parts[-1]}" if parts and len(path) > 24 else policy


def _to_png(figure: Figure) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def _style(axes: Axes, theme: Theme) -> None:
    axes.set_facecolor(theme.paper)
    axes.tick_params(colors=theme.muted, labelcolor=theme.ink)
    axes.grid(color=theme.muted, alpha=0.25, linewidth=0.6)
    for side, spine in axes.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(theme.muted)


def _root_ticks(end: float) -> list[float]:
    """Return round numbers from 0 to `end` whose roots are spaced about evenly."""
    rounds = [m * 10.0**k for k in range(-1, 6) for m in (1, 2, 5)]
    ticks = [0.0]
    for number in rounds:
        if number <= end and np.sqrt(number) - np.sqrt(ticks[-1]) >= 0.11 * np.sqrt(end):
            ticks.append(number)
    return ticks


def _extent(traces: Sequence[Trace]) -> tuple[float, float, float, float]:
    """Return (x_min, x_max, y_min, y_max) of the true walls with a margin, world frame [m]."""
    points = [trace.segments.reshape(-1, 2) for trace in traces] + [trace.circles[:, :2] for trace in traces]
    together = np.concatenate(points)
    (x_min, y_min), (x_max, y_max) = together.min(axis=0) - 0.3, together.max(axis=0) + 0.3
    return float(x_min), float(x_max), float(y_min), float(y_max)


def _map_figure(rows: int, cols: int, extent: tuple[float, float, float, float], width: float, theme: Theme) -> Figure:
    """Make a figure for maps that are `width` inches wide, and as high as the place asks for."""
    aspect = (extent[3] - extent[2]) / (extent[1] - extent[0])
    size = (cols * width + 0.3, rows * (min(max(aspect, 0.4), 2.0) * width + 0.3))
    return Figure(figsize=size, dpi=110, layout="constrained", facecolor=theme.paper)


def _draw_map(
    axes: Axes, trace: Trace, moment: float, end: float, extent: tuple[float, float, float, float], theme: Theme
) -> None:
    """Draw what was known at a moment.

    Args:
        axes: to draw in.
        trace: the episode.
        moment: time [s].
        end: time for the last colour [s].
        extent: (x_min, x_max, y_min, y_max) to show, world frame [m].
        theme: colours.
    """
    since, data = trace.known_since, trace.grid.data
    known = since <= moment
    ramp = LinearSegmentedColormap.from_list("times", theme.times)
    picture = np.full((*data.shape, 4), to_rgba(theme.unknown), dtype=np.float32)
    picture[known] = ramp(np.sqrt(since[known] / max(end, 1e-9)))
    picture[known & (data >= 50)] = to_rgba(theme.ink)
    x_min, y_min, x_max, y_max = trace.grid.bounds
    image = axes.imshow(picture, origin="lower", extent=(x_min, x_max, y_min, y_max), interpolation="auto")
    start = trace.start
    image.set_transform(Affine2D().rotate(start.theta).translate(start.x, start.y) + axes.transData)
    walls = LineCollection(list(trace.segments.reshape(-1, 2, 2)), colors=theme.error, linewidths=0.6, alpha=0.7)
    axes.add_collection(walls)
    rings = [Circle((x, y), radius) for x, y, radius in trace.circles]
    axes.add_collection(PatchCollection(rings, facecolor="none", edgecolor=theme.error, linewidth=0.6, alpha=0.7))
    samples = int(np.searchsorted(trace.curve.time, moment, side="right"))
    trail = start.transform(trace.trail[: max(samples, 1)])
    axes.plot(*trail.T, color=theme.paper, linewidth=2.4, alpha=0.8)
    axes.plot(*trail.T, color=theme.ink, linewidth=1.0)
    axes.plot(*trail[0], marker="o", markersize=4, color=theme.paper, markeredgecolor=theme.ink)
    axes.plot(*trail[-1], marker="o", markersize=4.5, color=theme.error, markeredgecolor=theme.paper)
    _clear(axes, extent, theme)
    axes.set_facecolor(theme.unknown)


def _clear(axes: Axes, extent: tuple[float, float, float, float], theme: Theme) -> None:
    """Show nothing but what is drawn in `extent`."""
    axes.set_facecolor(theme.paper)
    axes.set_xlim(extent[0], extent[1])
    axes.set_ylim(extent[2], extent[3])
    axes.set_aspect("equal")
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(False)

"""The explored fraction over time and distance, and performance profiles, with intervals."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from baselines.episode import Curve
from benchmarks.arena.statistics import Band, curve_band
from benchmarks.arena.theme import LIGHT, Theme, short

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
    """Average the explored fraction over each policy's episodes; one that has ended keeps its last value.

    Curves are given by policy and stratum, and sampled up to `end`; None takes the longest episode's end.
    """
    if end is None:
        end = max(float(getattr(c, over)[-1]) for strata in curves.values() for stratum in strata for c in stratum)
    grid = max(end, 1e-3) * np.linspace(0.0, 1.0, NUM_POINTS) ** 2
    bands = {}
    for policy, strata in curves.items():
        sampled = [
            np.array([np.interp(grid, getattr(curve, over), curve.explored_fraction) for curve in stratum])
            for stratum in strata
        ]
        bands[policy] = curve_band(sampled)
    return Bands(grid, bands)


def draw_curves(bands: Bands, quantity: str, theme: Theme = LIGHT) -> Figure:
    """Draw the explored fraction of each policy over a quantity, with its 95 % interval as a band."""
    figure, axes = _figure(theme)
    for mark in (90, 95, 99):
        axes.axhline(mark, color=theme.muted, linewidth=0.6, linestyle=(0, (2, 3)))
    _draw_bands(axes, bands, theme)
    end = float(bands.grid[-1])
    # Good explorers are done early and poor ones never: a linear axis would show a step and a plain.
    axes.set_xscale("function", functions=(np.sqrt, np.square))
    axes.set(xticks=_root_ticks(end), xlim=(0.0, end), ylim=(0.0, 102.0), yticks=[0, 25, 50, 75, 90, 100])
    axes.set_xlabel(f"{quantity}, square-root scale", color=theme.ink)
    axes.set_ylabel("explored [%]", color=theme.ink)
    _legend(axes, len(bands.by_policy), theme, "lower right")
    return figure


def draw_profiles(bands: Bands, score: str, theme: Theme = LIGHT) -> Figure:
    """Draw each policy's performance profile over thresholds of a score, with its 95 % interval as a band."""
    figure, axes = _figure(theme)
    _draw_bands(axes, bands, theme)
    axes.set(xlim=(float(bands.grid[0]), float(bands.grid[-1])), ylim=(0.0, 102.0))
    axes.set_xlabel(score, color=theme.ink)
    axes.set_ylabel("share of episodes [%]", color=theme.ink)
    _legend(axes, len(bands.by_policy), theme, "best")
    return figure


def _figure(theme: Theme) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(4.8, 3.3), dpi=200, layout="constrained", facecolor=theme.paper)
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


def _legend(axes: Axes, num_policies: int, theme: Theme, where: Literal["best", "lower right"]) -> None:
    size = 10 if num_policies <= 6 else 7
    legend = axes.legend(loc=where, frameon=False, labelcolor=theme.ink, fontsize=size, handlelength=2.4)
    legend.set_zorder(5)


def _root_ticks(end: float) -> list[float]:
    """Return round numbers from 0 to `end` whose roots are spaced about evenly."""
    ticks = [0.0]
    for number in (m * 10.0**k for k in range(-1, 6) for m in (1, 2, 5)):
        if number <= end and np.sqrt(number) - np.sqrt(ticks[-1]) >= 0.11 * np.sqrt(end):
            ticks.append(number)
    return ticks

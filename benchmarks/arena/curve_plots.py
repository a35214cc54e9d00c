"""The explored fraction over time and distance, with intervals."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from baselines.episode import Curve
from benchmarks.arena.statistics import curve_band
from benchmarks.arena.theme import LIGHT, Theme, short

NUM_POINTS = 200
"""Points at which curves are drawn."""


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

"""Two episodes from the same start side by side: a film in step, and one picture that shows where the time went."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize, to_rgba
from matplotlib.figure import Figure
from scipy import ndimage

from benchmarks.arena.plots import extent_of, show_map, show_only
from benchmarks.arena.theme import LIGHT
from benchmarks.arena.trace import Trace
from envs.measures import first_at

MARK = 0.95
"""Explored fraction that counts."""
LEAST_GAIN = 0.01
"""A drive that adds less than this explored fraction leads through what is known already."""
POCKET_TIME = 6.0
"""What is seen within this time after such a drive is what it led to [s]."""
PATH_COLORS = matplotlib.colormaps["viridis"]
"""From the start of the longer episode to its end."""
WALLS = replace(LIGHT, error=LIGHT.muted)
"""True walls are grey: red is for returns."""
LEGEND = "paths: coloured by time; red: the longest drive that added less than 1 %, and the pocket that it led to"


@dataclass(frozen=True, slots=True, eq=False)
class Return:
    """The longest drive through what was known already, before `MARK` was reached."""

    begin: float
    end: float
    """Times between which less than `LEAST_GAIN` was added [s]."""
    pocket: np.ndarray
    """Shape of the map, bool: the largest connected part of what was seen first on this drive or at its end."""
    area: float
    """Of the pocket [m2]."""
    left_at: float
    """Since when the pocket bordered on what was known, the median of the cells along it [s]."""

    def is_over(self, moment: float) -> bool:
        """Tell whether it has been made at a moment [s]."""
        return self.begin < self.end <= moment


def find_return(trace: Trace) -> Return:
    """Find the longest drive through what was known, and the pocket that it led to."""
    time, fraction = trace.curve.time, np.maximum.accumulate(trace.curve.progress)
    begins = time[np.searchsorted(fraction, fraction - LEAST_GAIN, side="right")]
    lengths = np.where(time <= first_at(time, fraction, MARK), time - begins, 0.0)
    last = int(lengths.argmax())
    begin, end = float(begins[last]), float(time[last])
    since, is_free = trace.known_since, (trace.grid.data >= 0) & (trace.grid.data < 50)
    new = is_free & (since > begin) & (since <= end + POCKET_TIME)
    labels, _ = ndimage.label(new, np.ones((3, 3)))
    pocket = labels == np.bincount(labels[new], minlength=2).argmax() if new.any() else new
    border = ndimage.binary_dilation(pocket, iterations=2) & is_free & (since <= begin)
    left_at = float(np.median(since[border])) if border.any() else begin
    return Return(begin, end, pocket, float(pocket.sum()) * trace.grid.resolution**2, left_at)


class SideBySide:
    """Draws two episodes as they are at a moment."""

    def __init__(self, traces: Mapping[str, Trace]) -> None:
        """Take two episodes from the same start, by the names of their explorers."""
        self._traces = traces
        self._returns = {name: find_return(trace) for name, trace in traces.items()}
        self.end = max(float(trace.curve.time[-1]) for trace in traces.values())
        """Time at which the longer one ends [s]."""

    def frames(self, count: int) -> list[np.ndarray]:
        """Return pictures at evenly spaced moments, shape (height, width, 3), uint8 each."""
        frames = []
        for moment in np.linspace(0.0, self.end, count):
            canvas = FigureCanvasAgg(self.draw(float(moment)))
            canvas.draw()
            frames.append(np.asarray(canvas.buffer_rgba())[..., :3].copy())
        return frames

    def draw(self, moment: float | None = None) -> Figure:
        """Draw what was known and driven at a moment [s]; None draws the end."""
        moment = self.end if moment is None else moment
        extent = extent_of(list(self._traces.values()))
        height = 5.0 * (extent[3] - extent[2]) / (extent[1] - extent[0])
        figure = Figure(figsize=(10.0, height + 3.0), dpi=100, facecolor=LIGHT.paper, layout="constrained")
        maps, below = figure.subfigures(2, height_ratios=(height + 0.9, 2.1))
        for axes, (name, trace) in zip(maps.subplots(1, 2), self._traces.items(), strict=True):
            self._draw_map(axes, trace, self._returns[name], moment)
            show_only(axes, extent, LIGHT.unknown)
            axes.set_title(self._title(name, trace, moment), color=LIGHT.ink, fontsize=11)
        maps.supxlabel(LEGEND, color=LIGHT.muted, fontsize=9)
        self._draw_curves(below.subplots(), moment)
        return figure

    def _title(self, name: str, trace: Trace, moment: float) -> str:
        found, fraction = self._returns[name], trace.curve.progress
        reached = first_at(trace.curve.time, fraction, MARK)
        if moment < reached:
            first = f"{name}: {100 * np.interp(moment, trace.curve.time, fraction):.0f} %"
        else:
            first = f"{name}: {100 * MARK:.0f} % after {reached:.0f} s"
        back = f"{found.end - found.begin:.0f} s back to {found.area:.1f} m² left at {found.left_at:.0f} s"
        return f"{first}\n{back if found.is_over(moment) else ''}"

    def _draw_map(self, axes: Axes, trace: Trace, found: Return, moment: float) -> None:
        known = trace.known_since <= moment
        picture = np.full((*known.shape, 4), to_rgba(LIGHT.unknown), dtype=np.float32)
        picture[known] = to_rgba(LIGHT.paper)
        if moment >= found.left_at:
            picture[found.pocket] = to_rgba(LIGHT.error, 0.25 if moment >= found.end else 0.55)
        picture[known & (trace.grid.data >= 50)] = to_rgba(LIGHT.ink)
        show_map(axes, picture, trace.grid, trace.start, trace.segments, WALLS)
        time = trace.curve.time
        count = max(int(np.searchsorted(time, moment, side="right")), 2)
        trail, time = trace.start.transform(trace.trail[:count]), time[:count]
        is_return = (time >= found.begin) & (time <= found.end)
        axes.plot(*trail[is_return].T, color=LIGHT.error, linewidth=5.0, alpha=0.55, solid_capstyle="round")
        if found.begin < found.end and is_return.any():
            axes.plot(*trail[is_return][0], marker="X", markersize=10, color=LIGHT.error, markeredgecolor=LIGHT.paper)
        pieces = np.stack([trail[:-1], trail[1:]], axis=1)
        axes.add_collection(
            LineCollection(list(pieces), array=time[1:], cmap=PATH_COLORS, norm=Normalize(0, self.end), linewidths=1.8)
        )
        axes.plot(*trail[0], marker="o", markersize=6, color=LIGHT.paper, markeredgecolor=LIGHT.ink)
        axes.plot(*trail[-1], marker="o", markersize=7, color=PATH_COLORS(time[-1] / self.end), markeredgecolor="k")

    def _draw_curves(self, axes: Axes, moment: float) -> None:
        """Draw the explored fractions; marks tell the longest drives through what was known."""
        colors = LIGHT.colors(list(self._traces))
        axes.axhline(100 * MARK, color=LIGHT.muted, linewidth=0.8, linestyle=(0, (2, 3)))
        for name, trace in self._traces.items():
            time, percent, found = trace.curve.time, 100 * trace.curve.progress, self._returns[name]
            past = time <= moment
            axes.plot(time[past], percent[past], color=colors[name], linewidth=2.0, label=name)
            if found.is_over(moment):
                level = float(np.interp(found.end, time, percent))
                axes.plot([found.begin, found.end], [level, level], color=LIGHT.error, linewidth=5.0, alpha=0.55)
        axes.set(xlim=(0, self.end), ylim=(0, 102), xlabel="time [s]", ylabel="explored [%]")
        for x, color in zip(np.linspace(0, self.end, 60), PATH_COLORS(np.linspace(0, 1, 60)), strict=True):
            axes.axvspan(x, x + self.end / 59, ymax=0.03, color=color, linewidth=0)
        axes.grid(color=LIGHT.muted, alpha=0.25)
        axes.legend(loc="lower right", frameon=False)

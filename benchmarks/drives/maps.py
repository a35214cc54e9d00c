"""Figures of maps from SLAM."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from matplotlib.transforms import Affine2D
from PIL import Image
from scipy import ndimage

from lidarnaut.benchmarks.arena.plots import hex_color
from lidarnaut.envs.geometry import ORIGIN, UNKNOWN, OccupancyGrid, Pose2D
from lidarnaut.envs.rendering import style

WALL_TOLERANCE = 0.15
"""Distance to the nearest true wall above which an occupied map cell counts as wrong [m]."""
VIEW_MARGIN = 0.5
COLUMNS, WIDTH = 3, 10.5
"""Panels per row, and width of the figure [in]."""
PATH, WRONG = style.TRUE, style.ESTIMATED
LEGEND = {"wall": style.OCCUPIED, "free": style.FREE, "unknown": style.UNKNOWN, "path": PATH}


class Panel(NamedTuple):
    """Map plotted in one panel of a figure; the figure's frame is common to all panels."""

    title: str
    grid: OccupancyGrid
    path: np.ndarray
    """Driven path in the figure's frame, with x and y in the first two columns, shape (n, >= 2) [m]."""
    wrong: np.ndarray | None = None
    """Mask of wrong occupied cells, shape of the map, bool; None without ground truth."""
    map_pose: Pose2D = ORIGIN
    """Pose of the map frame in the figure's frame."""


def draw_maps(path: Path, panels: Sequence[Panel], walls: OccupancyGrid, note: str) -> None:
    """Plot maps of the area `walls` side by side at equal scale, with scale bar, note and legend."""
    (x_min, y_min), (x_max, y_max) = np.reshape(walls.bounds, (2, 2)) + [[-VIEW_MARGIN], [VIEW_MARGIN]]
    legend = LEGEND if panels[-1].wrong is None else {**LEGEND, f"wall more than {WALL_TOLERANCE:g} m off": WRONG}
    lines = -(-len(panels) // COLUMNS)
    height = lines * (WIDTH / COLUMNS * (y_max - y_min) / (x_max - x_min) + 0.3) + 0.4
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    figure.get_layout_engine().set(rect=(0.0, 0.4 / height, 1.0, 1.0 - 0.4 / height))
    axes = figure.subplots(lines, COLUMNS, squeeze=False).ravel()
    for ax in axes:
        ax.set_axis_off()
    for ax, (title, grid, driven, wrong, map_pose) in zip(axes, panels):
        shade = np.clip(grid.data, 0, 100)[..., None] / 100.0
        colours = (1.0 - shade) * style.FREE + shade * style.OCCUPIED
        colours[grid.data == UNKNOWN] = style.UNKNOWN
        if wrong is not None:
            colours[ndimage.binary_dilation(wrong, iterations=2)] = WRONG
        left, low, right, high = grid.bounds
        image = ax.imshow(colours.astype(np.uint8), origin="lower", extent=(left, right, low, high))
        image.set_transform(Affine2D().rotate(map_pose.theta).translate(map_pose.x, map_pose.y) + ax.transData)
        ax.plot(*driven[:, :2].T, color=hex_color(PATH), linewidth=0.5, alpha=0.7)
        size = x_max - x_min, y_max - y_min
        ax.add_patch(Rectangle((x_min, y_min), *size, facecolor=hex_color(style.UNKNOWN), zorder=-1))
        ax.set(xlim=(x_min, x_max), ylim=(y_min, y_max))
        ax.set_title(title, fontsize=10)
    gap, length = 0.06 * (x_max - x_min), 5.0 if x_max - x_min > 8.0 else 1.0
    x, y = x_max - length - gap, y_min + gap
    axes[0].plot([x, x + length], [y, y], color=hex_color(style.INK), linewidth=3, solid_capstyle="butt")
    axes[0].text(x + 0.5 * length, y + 0.2 * gap, f"{length:g} m", ha="center", va="bottom", fontsize=9)
    marks = [Patch(facecolor=hex_color(colour), edgecolor="0.6", label=text) for text, colour in legend.items()]
    figure.text(0.01, 0.2 / height, note, fontsize=9, va="center")
    figure.legend(handles=marks, loc="center right", bbox_to_anchor=(0.995, 0.2 / height), ncols=5, fontsize=8)
    figure.savefig(path, dpi=100)
    with Image.open(path) as image:
        small = image.convert("RGB").quantize(96, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    small.save(path, optimize=True)


def wrong_cells(grid: OccupancyGrid, map_pose: Pose2D, walls: OccupancyGrid) -> np.ndarray:
    """Return a mask of occupied map cells farther than `WALL_TOLERANCE` from true walls: shape of the map, bool.

    The pose `map_pose` of the map frame and the true occupancy grid `walls` are in the world frame.
    """
    distance = ndimage.distance_transform_edt(walls.data == 0) * walls.resolution
    occupied = np.argwhere(grid.occupied)
    cells = walls.cells(map_pose.transform(grid.centers(occupied)))
    is_wrong = ~walls.contains(cells)
    is_wrong[~is_wrong] = distance[tuple(cells[~is_wrong].T)] > WALL_TOLERANCE
    wrong = np.zeros(grid.data.shape, dtype=np.bool_)
    wrong[tuple(occupied[is_wrong].T)] = True
    return wrong

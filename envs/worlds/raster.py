"""Worlds as rasters: which cells are touched, what can be reached, whether the outside can; and rasters as outlines."""

import numpy as np
from numba import njit
from scipy import ndimage

from lidarnaut.envs.geometry import FREE, OCCUPIED, OccupancyGrid
from lidarnaut.envs.geometry.clearance import clearance
from lidarnaut.envs.geometry.lines import next_cell, start_walk

from .world import MAX_COORDINATE, World

MAX_CELLS = 100_000_000
"""Most cells of a raster: 500 m x 500 m in cells of 0.05 m, which take some gigabytes to work on."""
CHECK_RESOLUTION = 0.05
"""Side of the cells in which worlds are checked for leaks [m]."""
_SNAP = 1e-3
"""Coordinates this close below a cell border count as on it [cells], so that rounding errors decide nothing."""
_ON = 0.01
"""A spawn this close to a wall or a body lies on it [m]."""


@njit(cache=True, error_model="numpy")
def _set(data, row, col):
    if 0 <= row < data.shape[0] and 0 <= col < data.shape[1]:
        data[row, col] = OCCUPIED


@njit(cache=True, error_model="numpy")
def _draw_segment(data, x0, y0, x1, y1):
    """Set every cell that the segment (in units of cells) crosses; through a corner, both cells beside it too."""
    walk = start_walk(x0, y0, x1, y1)
    _set(data, walk.row, walk.col)
    while walk.rows_left + walk.cols_left > 0:
        if abs(walk.next_col - walk.next_row) < 1e-12:
            _set(data, walk.row, walk.col + walk.col_step)
            _set(data, walk.row + walk.row_step, walk.col)
        walk = next_cell(walk)
        _set(data, walk.row, walk.col)


@njit(cache=True, error_model="numpy")
def _draw_disc(data, x, y, radius):
    """Set every cell that has a point within `radius` of (x, y), all in units of cells."""
    height, width = data.shape
    for row in range(max(int(np.floor(y - radius)), 0), min(int(np.floor(y + radius)) + 1, height)):
        for col in range(max(int(np.floor(x - radius)), 0), min(int(np.floor(x + radius)) + 1, width)):
            dx = max(col - x, 0.0, x - (col + 1))
            dy = max(row - y, 0.0, y - (row + 1))
            if dx * dx + dy * dy <= radius * radius:
                data[row, col] = OCCUPIED


@njit(cache=True, error_model="numpy")
def _draw(data, segments, circles):
    """Set all cells touched by segments (n, 4) and circles (m, 3), in units of cells."""
    for i in range(segments.shape[0]):
        _draw_segment(data, segments[i, 0], segments[i, 1], segments[i, 2], segments[i, 3])
    for i in range(circles.shape[0]):
        _draw_disc(data, circles[i, 0], circles[i, 1], circles[i, 2])


def rasterize(world: World, resolution: float) -> OccupancyGrid:
    """Mark the cells, of side `resolution` [m], that a world's static segments and circles touch.

    A cell owns its lower and left border, circles are filled, the inside of other bodies is not. Movers are left out.
    Returns 0 (free) and 100 (touched) over the world's bounds and at least one more cell on each side, world frame.
    ValueError if the resolution is not positive, or so fine that there would be more than `MAX_CELLS`.
    """
    if not resolution > 0:
        raise ValueError(f"resolution must be positive, got {resolution!r}")
    x_min, y_min, x_max, y_max = world.bounds
    origin = np.array([x_min - resolution, y_min - resolution])
    cols, rows = (x_max - x_min) / resolution + 3, (y_max - y_min) / resolution + 3
    if not cols * rows <= MAX_CELLS:
        raise ValueError(
            f"world {world.name!r} spans {x_max - x_min:g} x {y_max - y_min:g} m, which is {cols * rows:.3g} cells of "
            f"{resolution:g} m; at most {MAX_CELLS:,} are allowed"
        )
    width, height = int(cols + _SNAP), int(rows + _SNAP)
    data = np.full((height, width), FREE, dtype=np.int8)
    segments = (world.segments - np.tile(origin, 2)) / resolution + _SNAP
    circles = np.column_stack([world.circles[:, :2] - origin, world.circles[:, 2]]) / resolution
    _draw(data, segments, circles)
    return OccupancyGrid(data, resolution, (float(origin[0]), float(origin[1])))


def reachable(
    world: World, resolution: float = CHECK_RESOLUTION, radius: float = 0.0
) -> tuple[OccupancyGrid, np.ndarray]:
    """Find where the centre of a robot of a radius [m] can get from the first spawn, on cells of a side [m].

    Returns the raster of the world, and a mask of its shape: cells farther than `radius` from every touched cell and
    connected to the first spawn through the sides of such cells. Empty where the robot does not fit at the spawn.
    """
    grid = rasterize(world, resolution)
    free = grid.data == FREE
    if radius > 0:
        free = ndimage.distance_transform_edt(free) * resolution > radius
    labels, _ = ndimage.label(free)
    row, col = grid.cells(np.array(world.spawns[0][:2]))
    inside = grid.contains(np.array([row, col])) and labels[row, col] > 0
    return grid, labels == labels[row, col] if inside else np.zeros_like(free)


def free_area(world: World, radius: float = 0.0) -> float:
    """Return the size of the area that the centre of a robot of `radius` can reach from the first spawn [m2]."""
    grid, mask = reachable(world, radius=radius)
    return float(np.count_nonzero(mask)) * grid.resolution**2


def leaks(mask: np.ndarray) -> bool:
    """Tell whether an area (a mask from `reachable`) comes to the edge of the raster, that is out of the world."""
    return bool(mask[[0, -1]].any() or mask[:, [0, -1]].any())


def check_world(world: World) -> World:
    """Return a world after making sure that robots can be driven in it.

    Raises:
        ValueError: if there is no spawn, a spawn or goal lies on something solid or out of bounds, they are not
            connected, goals are not as many as spawns, the outside can be reached, numbers are not finite, or the world
            is too large to be worked on.
    """
    if not world.spawns:
        raise ValueError(f"world {world.name!r} has no spawn; give at least one pose (x, y, heading)")
    numbers = [(what, getattr(world, what)) for what in ("bounds", "segments", "circles", "spawns", "goals")]
    for what, values in numbers + [("people", person.waypoints) for person in world.people]:
        farthest = np.abs(np.asarray(values, dtype=np.float64)).max(initial=0.0)
        if not farthest <= MAX_COORDINATE:
            raise ValueError(f"world {world.name!r}: {what} hold {farthest:g}, at most {MAX_COORDINATE:g} m is allowed")
    if len(world.goals) not in (0, len(world.spawns)):
        goals, spawns = len(world.goals), len(world.spawns)
        raise ValueError(f"world {world.name!r} has {goals} goals and {spawns} spawns; give one for each or none")
    grid = rasterize(world, CHECK_RESOLUTION)
    labels, _ = ndimage.label(grid.data == FREE)
    poses = [("spawn", pose) for pose in world.spawns] + [("goal", pose) for pose in world.goals]
    pieces = []
    for what, pose in poses:
        cell = grid.cells(np.array([pose.x, pose.y]))
        if not grid.contains(cell):
            raise ValueError(f"world {world.name!r}: {what} {tuple(pose)} lies outside its bounds {world.bounds}")
        if labels[tuple(cell)] == 0 or clearance(pose.x, pose.y, world.segments, world.circles) < _ON:
            raise ValueError(
                f"world {world.name!r}: {what} {tuple(pose)} lies on or within {CHECK_RESOLUTION} m of a wall or a body"
            )
        pieces.append(labels[tuple(cell)])
    if leaks(labels == pieces[0]):
        raise ValueError(
            f"world {world.name!r} leaks: the outside of its bounds {world.bounds} can be reached from "
            f"{tuple(world.spawns[0])}; close the gap with a segment under `closures`"
        )
    for (what, pose), piece in zip(poses, pieces):
        if piece != pieces[0]:
            raise ValueError(
                f"world {world.name!r}: {what} {tuple(pose)} cannot be reached from {tuple(world.spawns[0])}"
            )
    return world


def outline(solid: np.ndarray, xs: np.ndarray, ys: np.ndarray) -> np.ndarray:
    """Return the borders between solid and open cells, straight neighbours merged: shape (n, 4), (x0, y0, x1, y1) [m].

    `solid`: shape (height, width), bool; beyond the array counts as solid, so that no segments run along its edge
    unless open cells touch it. `xs`, `ys`: shapes (width + 1,) and (height + 1,), positions of the grid lines [m].
    """
    padded = np.pad(solid, 1, constant_values=True)
    # Border k of a row of cells lies between cell k - 1 and cell k.
    cols, bottoms, tops = _runs((padded[1:-1, 1:] != padded[1:-1, :-1]).T)
    rows, lefts, rights = _runs(padded[1:, 1:-1] != padded[:-1, 1:-1])
    segments = np.empty((len(cols) + len(rows), 4))
    upright, level = segments[: len(cols)], segments[len(cols) :]
    upright[:, 0] = upright[:, 2] = xs[cols]
    upright[:, 1], upright[:, 3] = ys[bottoms], ys[tops]
    level[:, 1] = level[:, 3] = ys[rows]
    level[:, 0], level[:, 2] = xs[lefts], xs[rights]
    return segments


def _runs(marks: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the runs of true values along the rows: row, start and end of each, all of shape (n,), int64."""
    steps = np.diff(np.pad(marks.astype(np.int8), ((0, 0), (1, 1))), axis=1)
    rows, starts = np.nonzero(steps == 1)
    return rows, starts, np.nonzero(steps == -1)[1]

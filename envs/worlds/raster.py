"""Rasterization and validity checks of worlds."""

import numpy as np
from scipy import ndimage

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry import FREE, OCCUPIED, OccupancyGrid
from lidarnaut.envs.geometry.clearance import clearance
from lidarnaut.envs.geometry.lines import next_cell, start_walk

from .world import World

MAX_CELLS = 100_000_000
"""Maximum number of cells of a raster, such as 500 m x 500 m at 0.05 m."""
CHECK_RESOLUTION = 0.05
"""Cell size for validity checks of worlds [m]."""
_SNAP = 1e-3
_MIN_CLEARANCE = 0.01
"""Minimum distance of a spawn or goal from walls and bodies [m]."""


@njit(cache=True, error_model="numpy")
def _set(data, row, col):
    if 0 <= row < data.shape[0] and 0 <= col < data.shape[1]:
        data[row, col] = OCCUPIED


@njit(cache=True, error_model="numpy")
def _draw_segment(data, x0, y0, x1, y1):
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
    height, width = data.shape
    for row in range(max(int(np.floor(y - radius)), 0), min(int(np.floor(y + radius)) + 1, height)):
        for col in range(max(int(np.floor(x - radius)), 0), min(int(np.floor(x + radius)) + 1, width)):
            dx = max(col - x, 0.0, x - (col + 1))
            dy = max(row - y, 0.0, y - (row + 1))
            if dx * dx + dy * dy <= radius * radius:
                data[row, col] = OCCUPIED


@njit(cache=True, error_model="numpy")
def _draw(data, segments, circles):
    for i in range(segments.shape[0]):
        _draw_segment(data, segments[i, 0], segments[i, 1], segments[i, 2], segments[i, 3])
    for i in range(circles.shape[0]):
        _draw_disc(data, circles[i, 0], circles[i, 1], circles[i, 2])


def rasterize(world: World, resolution: float) -> OccupancyGrid:
    """Return the occupancy grid of a world's static geometry, with cells of side `resolution` [m], world frame.

    Cells touched by segments or circles are 100, others 0. Circles are filled; other bodies are outlines. The grid
    extends at least one cell beyond the world.

    Raises:
        ValueError: `resolution` is not positive or gives more than `MAX_CELLS` cells.
    """
    if not resolution > 0:
        raise ValueError(f"resolution must be positive, got {resolution!r}")
    x_min, y_min, x_max, y_max = world.bounds
    origin = np.array([x_min - resolution, y_min - resolution])
    cols, rows = (x_max - x_min) / resolution + 3, (y_max - y_min) / resolution + 3
    if not cols * rows <= MAX_CELLS:
        size = f"{x_max - x_min:g} x {y_max - y_min:g} m, which is {cols * rows:.3g} cells of {resolution:g} m"
        raise ValueError(f"world {world.name!r} spans {size}; at most {MAX_CELLS:,} are allowed")
    width, height = int(cols + _SNAP), int(rows + _SNAP)
    data = np.full((height, width), FREE, dtype=np.int8)
    segments = (world.segments - np.tile(origin, 2)) / resolution + _SNAP
    _draw(data, segments, np.column_stack([world.circles[:, :2] - origin, world.circles[:, 2]]) / resolution)
    return OccupancyGrid(data, resolution, (float(origin[0]), float(origin[1])))


def reachable(
    world: World, resolution: float = CHECK_RESOLUTION, radius: float = 0.0
) -> tuple[OccupancyGrid, np.ndarray]:
    """Return the raster of a world, and the mask of cells that a robot can reach from the first start pose.

    `resolution`: side of a cell [m]; `radius`: of the robot [m]. The mask has the shape of the raster, bool.
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
    """Return the area that a robot of `radius` [m] can reach from the first spawn [m2]."""
    grid, mask = reachable(world, radius=radius)
    return float(np.count_nonzero(mask)) * grid.resolution**2


def check_world(world: World) -> World:
    """Validate a world and return it.

    Raises:
        ValueError: the world is not closed or too large; or spawns or goals are missing, in collision, out of bounds or
            unreachable.
    """
    if not world.spawns:
        raise ValueError(f"world {world.name!r} has no spawn; give at least one pose (x, y, heading)")
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
        if labels[tuple(cell)] == 0 or clearance(pose.x, pose.y, world.segments, world.circles) < _MIN_CLEARANCE:
            near = f"on or within {CHECK_RESOLUTION} m of a wall or a body"
            raise ValueError(f"world {world.name!r}: {what} {tuple(pose)} lies {near}")
        pieces.append(labels[tuple(cell)])
    inside = labels == pieces[0]
    if inside[[0, -1]].any() or inside[:, [0, -1]].any():
        leak = f"the outside of its bounds {world.bounds} can be reached from {tuple(world.spawns[0])}"
        raise ValueError(f"world {world.name!r} leaks: {leak}; close the gap with a segment under `closures`")
    for (what, pose), piece in zip(poses, pieces):
        if piece != pieces[0]:
            spawn = tuple(world.spawns[0])
            raise ValueError(f"world {world.name!r}: {what} {tuple(pose)} cannot be reached from {spawn}")
    return world


def outline(solid: np.ndarray, xs: np.ndarray, ys: np.ndarray) -> np.ndarray:
    """Return the borders between solid and open cells as segments (x0, y0, x1, y1): shape (n, 4) [m].

    `solid`: shape (height, width), bool; cells outside the array count as solid. `xs`, `ys`: positions of the grid
    lines, shapes (width + 1,) and (height + 1,) [m].
    """
    padded = np.pad(solid, 1, constant_values=True)
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
    steps = np.diff(np.pad(marks.astype(np.int8), ((0, 0), (1, 1))), axis=1)
    rows, starts = np.nonzero(steps == 1)
    return rows, starts, np.nonzero(steps == -1)[1]

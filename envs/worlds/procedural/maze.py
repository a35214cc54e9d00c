import numpy as np

from ..raster import outline
from ..world import World
from .plan import Size, world_within

_WALL = 0.1
"""Thickness of the walls [m]."""


def build(name: str, rng: np.random.Generator, size: Size) -> World:
    """Return a maze of the given outer size [m], with corridors about 0.9 to 1.6 m wide."""
    width, height = size
    corridor = float(rng.uniform(0.9, 1.4))
    cols, rows = (max(2, int((side - _WALL) / (corridor + _WALL))) for side in (width, height))
    solid = _carve(rng, rows, cols)
    _open_up(rng, solid, loops=float(rng.uniform(0.0, 0.08)), chambers=int(rng.integers(1 + rows * cols // 40)))
    xs, ys = _lines(width, cols), _lines(height, rows)
    segments = outline(solid, xs, ys)
    col, row = int(rng.integers(cols)), int(rng.integers(rows))
    spawn = (xs[2 * col + 1] + xs[2 * col + 2]) / 2, (ys[2 * row + 1] + ys[2 * row + 2]) / 2
    return world_within(name, size, rng, spawn, segments, np.empty((0, 3)))


def _lines(length: float, count: int) -> np.ndarray:
    starts = (length - _WALL) / count * np.arange(count + 1)
    return np.column_stack([starts, starts + _WALL]).ravel()


def _carve(rng: np.random.Generator, rows: int, cols: int) -> np.ndarray:
    """Return the solid cells of a maze from depth-first search: shape (2 rows + 1, 2 cols + 1), bool.

    Corridors have odd indices.
    """
    solid = np.ones((2 * rows + 1, 2 * cols + 1), dtype=bool)
    solid[1::2, 1::2] = False
    visited = {(0, 0)}
    trail = [(0, 0)]
    while trail:
        row, col = trail[-1]
        beside = (row, col + 1), (row, col - 1), (row + 1, col), (row - 1, col)
        unvisited = [(r, c) for r, c in beside if 0 <= r < rows and 0 <= c < cols and (r, c) not in visited]
        if not unvisited:
            trail.pop()
            continue
        r, c = unvisited[int(rng.integers(len(unvisited)))]
        solid[row + r + 1, col + c + 1] = False
        visited.add((r, c))
        trail.append((r, c))
    return solid


def _open_up(rng: np.random.Generator, solid: np.ndarray, loops: float, chambers: int) -> None:
    inner = solid[1:-1, 1:-1]
    gone = rng.random(inner.shape) < loops
    gone[1::2, 1::2] = False  # posts stay
    inner[gone] = False
    rows, cols = solid.shape[0] // 2, solid.shape[1] // 2
    for _ in range(chambers):
        if rows > 2 and cols > 2:
            row, col = int(rng.integers(rows - 1)), int(rng.integers(cols - 1))
            solid[2 * row + 1 : 2 * row + 4, 2 * col + 1 : 2 * col + 4] = False
    # Remove posts without walls.
    posts = solid[2:-1:2, 2:-1:2]
    posts &= solid[1:-2:2, 2:-1:2] | solid[3::2, 2:-1:2] | solid[2:-1:2, 1:-2:2] | solid[2:-1:2, 3::2]

"""Caves from a cellular automaton with smoothed walls."""

import math

import numpy as np
from scipy import ndimage

from lidarnaut.envs.compilation import njit

from ..world import World
from .plan import Size, world_within

_CELL = 0.4
"""Side of a cell of the cellular automaton [m]."""
_STEP = 0.1
"""Grid spacing of the distance field whose contour is the cave wall [m]."""
_CLEARANCE_RADIUS = 0.35
"""Radius of a disc that fits through all passages [m]: robot radius plus contour error."""
_OUTER_WALL = 0.2
"""Minimum thickness of the outer wall [m]."""


def build(name: str, rng: np.random.Generator, size: Size) -> World:
    """Return a cave of the given outer size [m]."""
    width, height = size
    shape = int(height / _STEP) + 1, int(width / _STEP) + 1
    fill = float(rng.uniform(0.42, 0.5))
    core = _largest(_traversable(rng, shape, fill))
    while np.count_nonzero(core) * _STEP**2 < 0.3 * width * height:
        fill -= 0.02  # ends without any rock
        core = _largest(_traversable(rng, shape, fill))
    # Free space is the union of all collision-free discs.
    distance = ndimage.distance_transform_edt(~core) * _STEP
    labels, _ = ndimage.label(distance >= _CLEARANCE_RADIUS)
    small = np.bincount(labels.ravel()) * _STEP**2 < 0.1
    small[0] = False
    distance[small[labels]] = 0.0
    offset = (np.array([width, height]) - _STEP * (np.array(shape[::-1]) - 1)) / 2
    segments = contour(distance, _CLEARANCE_RADIUS, tolerance=0.25) * _STEP + np.tile(offset, 2)
    cells = np.argwhere(core)
    spawn = offset + _STEP * cells[int(rng.integers(len(cells)))][::-1]
    return world_within(name, size, rng, spawn, segments, np.empty((0, 3)))


def _traversable(rng: np.random.Generator, shape: tuple[int, int], fill: float) -> np.ndarray:
    """Grow a cave with a cellular automaton; return the mask of collision-free positions."""
    coarse = [math.ceil(side * _STEP / _CELL) + 1 for side in shape]
    rock = np.pad(rng.random(coarse) < fill, 1, constant_values=True)
    for _ in range(4):
        # A cell is rock if most of its neighbourhood is rock.
        rows = rock[:-2].astype(np.int8) + rock[1:-1] + rock[2:]
        rock[1:-1, 1:-1] = rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:] >= 5
    fine = round(_CELL / _STEP)
    field = np.repeat(np.repeat(rock[1:-1, 1:-1].astype(np.float32), fine, axis=0), fine, axis=1)
    open_ground = ndimage.gaussian_filter(field, 0.6 * fine, mode="nearest")[: shape[0], : shape[1]] < 0.5
    edge = round(_OUTER_WALL / _STEP)
    framed = np.zeros(shape, dtype=bool)
    framed[edge:-edge, edge:-edge] = open_ground[edge:-edge, edge:-edge]
    return ndimage.distance_transform_edt(framed) * _STEP > _CLEARANCE_RADIUS


def _largest(mask: np.ndarray) -> np.ndarray:
    labels, count = ndimage.label(mask)
    return labels == 1 + int(np.argmax(np.bincount(labels.ravel())[1:])) if count else mask


@njit(cache=True, error_model="numpy")
def _link(links, a, b):
    links[a, 0 if links[a, 0] < 0 else 1] = b
    links[b, 0 if links[b, 0] < 0 else 1] = a


@njit(cache=True, error_model="numpy")
def _march(field, level, links, points):
    """Find the crossings of a contour with grid edges, and link neighbouring crossings (marching squares)."""
    height, width = field.shape
    for row in range(height):
        for col in range(width):
            k = row * width + col
            here = field[row, col]
            if col + 1 < width and (here < level) != (field[row, col + 1] < level):
                points[2 * k, 0] = col + (level - here) / (field[row, col + 1] - here)
                points[2 * k, 1] = row
            if row + 1 < height and (here < level) != (field[row + 1, col] < level):
                points[2 * k + 1, 0] = col
                points[2 * k + 1, 1] = row + (level - here) / (field[row + 1, col] - here)
    for row in range(height - 1):
        for col in range(width - 1):
            k = row * width + col
            south, north, west, east = 2 * k, 2 * (k + width), 2 * k + 1, 2 * (k + 1) + 1
            a, b = field[row, col] < level, field[row, col + 1] < level
            c, d = field[row + 1, col] < level, field[row + 1, col + 1] < level
            if a != b and c != d and a != c:
                # Saddle: separate the low corners.
                _link(links, south, west if a else east)
                _link(links, north, east if a else west)
            else:
                first = -1
                for edge, crossed in ((south, a != b), (north, c != d), (west, a != c), (east, b != d)):
                    if crossed:
                        if first < 0:
                            first = edge
                        else:
                            _link(links, first, edge)


@njit(cache=True, error_model="numpy")
def _trace(links, points, tolerance, segments):
    count = 0
    loop = np.empty(links.shape[0], dtype=np.int64)
    for start in range(links.shape[0]):
        if links[start, 0] < 0:
            continue
        n, edge = 0, start
        while links[edge, 0] >= 0:
            loop[n] = edge
            n += 1
            ahead = links[edge, 0] if n == 1 or links[edge, 0] != loop[n - 2] else links[edge, 1]
            links[edge, 0] = -1
            edge = ahead
        i = 0
        while i < n:
            j = i + 1
            while j < n and _is_straight(points, loop, i, j + 1, n, tolerance):
                j += 1
            here, there = loop[i], loop[j % n]
            segments[count, 0], segments[count, 1] = points[here, 0], points[here, 1]
            segments[count, 2], segments[count, 3] = points[there, 0], points[there, 1]
            count += 1
            i = j
    return count


@njit(cache=True, error_model="numpy")
def _is_straight(points, loop, i, j, n, tolerance):
    x, y = points[loop[i], 0], points[loop[i], 1]
    dx, dy = points[loop[j % n], 0] - x, points[loop[j % n], 1] - y
    length = np.hypot(dx, dy)
    if length == 0.0:
        return False
    for k in range(i + 1, j):
        px, py = points[loop[k], 0], points[loop[k], 1]
        if abs((px - x) * dy - (py - y) * dx) > tolerance * length:
            return False
    return True


def contour(field: np.ndarray, level: float, tolerance: float) -> np.ndarray:
    """Return the closed contour lines of a 2D array as segments (column, row, column, row): shape (n, 4) [grid steps].

    `field`: shape (height, width), border values all above or all below `level`; `tolerance`: maximum error of
    simplified lines [grid steps].
    """
    links = np.full((2 * field.size, 2), -1, dtype=np.int64)
    points = np.zeros((2 * field.size, 2))
    _march(field, level, links, points)
    segments = np.empty((np.count_nonzero(links[:, 0] >= 0), 4))
    return segments[: _trace(links, points, tolerance, segments)]

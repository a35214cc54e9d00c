"""Caves: a cellular automaton, smoothed into rounded walls."""

import math

import numpy as np
from scipy import ndimage

from ..world import World
from .contour import contour
from .plan import Size, world_within

_CELL = 0.4
"""Side of the automaton's cells [m]."""
_STEP = 0.1
"""Distance between the points of the drawing [m]."""
_REACH = 0.35
"""Radius of the disc that gets everywhere [m]: what a robot of 0.25 m radius needs, and the drawing's error."""
_MARGIN = 0.2
"""Least thickness of the outer wall [m]."""


def build(name: str, rng: np.random.Generator, size: Size) -> World:
    """Return a cave of the given outer size [m]."""
    width, height = size
    shape = int(height / _STEP) + 1, int(width / _STEP) + 1
    fill = float(rng.uniform(0.42, 0.5))
    core = _largest(_traversable(rng, shape, fill))
    while np.count_nonzero(core) * _STEP**2 < 0.3 * width * height:
        fill -= 0.02  # at the latest without any rock there is room enough
        core = _largest(_traversable(rng, shape, fill))
    # Free is what lies within reach of where the disc's centre can be, so that no corner is too tight for it.
    distance = ndimage.distance_transform_edt(~core) * _STEP
    _sweep(distance)
    offset = (np.array([width, height]) - _STEP * (np.array(shape[::-1]) - 1)) / 2
    segments = contour(distance, _REACH, tolerance=0.25) * _STEP + np.tile(offset, 2)
    cells = np.argwhere(core)
    spawn = offset + _STEP * cells[int(rng.integers(len(cells)))][::-1]
    return world_within(name, size, rng, spawn, segments, np.empty((0, 3)))


def _traversable(rng: np.random.Generator, shape: tuple[int, int], fill: float) -> np.ndarray:
    """Grow a cave and return where in it the centre of a disc of radius `_REACH` can be: bool, of the given shape."""
    coarse = [math.ceil(side * _STEP / _CELL) + 1 for side in shape]
    rock = np.pad(rng.random(coarse) < fill, 1, constant_values=True)
    for _ in range(4):
        # A cell is rock if most of its neighbourhood is.
        rows = rock[:-2].astype(np.int8) + rock[1:-1] + rock[2:]
        rock[1:-1, 1:-1] = rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:] >= 5
    fine = round(_CELL / _STEP)
    field = np.repeat(np.repeat(rock[1:-1, 1:-1].astype(np.float32), fine, axis=0), fine, axis=1)
    open_ground = ndimage.gaussian_filter(field, 0.6 * fine, mode="nearest")[: shape[0], : shape[1]] < 0.5
    edge = round(_MARGIN / _STEP)
    framed = np.zeros(shape, dtype=bool)
    framed[edge:-edge, edge:-edge] = open_ground[edge:-edge, edge:-edge]
    return ndimage.distance_transform_edt(framed) * _STEP > _REACH


def _sweep(distance: np.ndarray) -> None:
    """Take away rocks of less than 0.1 m2, in place."""
    labels, _ = ndimage.label(distance >= _REACH)
    small = np.bincount(labels.ravel()) * _STEP**2 < 0.1
    small[0] = False
    distance[small[labels]] = 0.0


def _largest(mask: np.ndarray) -> np.ndarray:
    """Return the largest connected part of a mask."""
    labels, count = ndimage.label(mask)
    return labels == 1 + int(np.argmax(np.bincount(labels.ravel())[1:])) if count else mask

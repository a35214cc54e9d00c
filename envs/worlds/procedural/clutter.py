"""Fields of cylinders, generated as in the BARN benchmark."""

import numpy as np
from scipy import ndimage

from ..world import World
from .plan import UNIT, Size, units, with_goals, world_within

_RADIUS = 0.075
_CELL = 3
"""Side of a cell of the cellular automaton [grid cells of 0.05 m]."""
_WALL_DISTANCE = 5.0
"""Distance of the outer wall from cylinders and goal [m]."""
_START_DISTANCE = 3.0
"""Distance of the start from the rear wall [m]."""
_RUN_IN_ROWS = 33
"""Number of cell rows between the rear wall and the field of cylinders."""
_GOAL_DISTANCE = 3.4
"""Distance of the goal beyond the field of cylinders [m]."""
_CLEARANCE_RADIUS = 0.36
"""Radius of a disc that can cross every generated field of cylinders [m]: Jackal radius 0.333 m plus raster error."""
_FILL = 0.15, 0.28
"""Initial fraction of filled cells at difficulty 0 and at difficulty 1."""
_SMOOTHINGS = 2, 5
_PADDING_ROWS = 8
"""Number of empty cell rows added before and behind the field of cylinders to check that a robot can cross it."""


def build(name: str, rng: np.random.Generator, size: Size, difficulty: float | None = None) -> World:
    """Return a field of cylinders of the given outer size [m], with the goal beyond the field.

    `difficulty`, from 0 to 1, sets the share of filled cells; None draws a value. Fields without a passage are drawn
    again with fewer filled cells. After Perille, Truong, Xiao and Stone, "Benchmarking Metric Ground Navigation"
    (2020).
    """
    width, height = size
    rows = int((height - 2.0 * _WALL_DISTANCE - _GOAL_DISTANCE) / (UNIT * _CELL) + 1e-6) - 1 - _RUN_IN_ROWS
    cols = int((width - 2.0 * _WALL_DISTANCE) / (UNIT * _CELL) + 1e-6)
    if difficulty is not None and not 0.0 <= difficulty <= 1.0:
        raise ValueError(f"difficulty must lie in [0, 1], got {difficulty!r}")
    hardness = float(rng.random() if difficulty is None else difficulty)
    fill, smoothings = _FILL[0] + hardness * (_FILL[1] - _FILL[0]), int(rng.integers(*_SMOOTHINGS))
    while not _has_passage(field := _grow(rng, (rows, cols), fill, smoothings)):
        fill *= 0.99
    filled = np.zeros((1 + _RUN_IN_ROWS + rows, cols), dtype=bool)
    filled[1 + _RUN_IN_ROWS :] = field
    filled[0] = filled[:, [0, -1]] = True
    filled &= _neighbors(filled) < 8  # remove enclosed cylinders
    left = UNIT * ((units(width) - _CELL * cols) // 2)
    centres = (left, _WALL_DISTANCE) + UNIT * _CELL * (np.argwhere(filled)[:, ::-1] + 0.5)
    circles = np.ascontiguousarray(np.column_stack([centres, np.full(len(centres), _RADIUS)]))
    middle = left + 0.5 * UNIT * _CELL * cols
    start, goal = (middle, _WALL_DISTANCE + _START_DISTANCE), (middle, height - _WALL_DISTANCE)
    return with_goals(world_within(name, size, rng, start, np.empty((0, 4)), circles), [(start, goal)])


def _neighbors(cells: np.ndarray) -> np.ndarray:
    return ndimage.convolve(cells.astype(np.int8), [[1, 1, 1], [1, 0, 1], [1, 1, 1]], mode="constant")


def _grow(rng: np.random.Generator, shape: tuple[int, int], fill: float, smoothings: int) -> np.ndarray:
    cells = np.pad(rng.random(shape) < fill, 1)
    cells[:, [0, 1, -2, -1]] = True
    for _ in range(smoothings):
        number = _neighbors(cells)[1:-1, 1:-1]
        cells[1:-1, 1:-1] = (number > 4) | (cells[1:-1, 1:-1] & (number >= 2))
    return cells[1:-1, 1:-1]


def _has_passage(field: np.ndarray) -> bool:
    rows, cols = field.shape
    filled = np.zeros((rows + 2 * _PADDING_ROWS, cols), dtype=bool)
    filled[_PADDING_ROWS:-_PADDING_ROWS] = field
    filled[:_PADDING_ROWS, [0, -1]] = True
    is_empty = np.ones((_CELL * filled.shape[0], _CELL * cols), dtype=bool)
    is_empty[1::_CELL, 1::_CELL] = ~filled
    labels, _ = ndimage.label(ndimage.distance_transform_edt(is_empty) * UNIT > _RADIUS + _CLEARANCE_RADIUS)
    before, beyond = labels[_CELL * _PADDING_ROWS // 2, _CELL * cols // 2], labels[-1, _CELL * cols // 2]
    return bool(before == beyond > 0)

"""Which cells of a raster see one of some others along a straight line of free cells."""

import math

import numpy as np
from numba import njit
from tqdm import tqdm

from envs.geometry.lines import cell_along, longest_step

NUM_DIRECTIONS = 180
"""Directions in which a goal is searched for from a cell."""
_FAR = np.uint16(2**16 - 1)
"""Steps to a goal that is out of reach [cells]."""
_ROWS = 50
"""Rows of cells between two updates of the progress bar."""
_DELAY = 2.0
"""Time after which there is a progress bar [s]."""


def visible_from(
    free: np.ndarray, goals: np.ndarray, candidates: np.ndarray, reach: float, name: str = ""
) -> np.ndarray:
    """Find the cells that see, or are, one of the goals, with a progress bar if it takes longer than two seconds.

    Args:
        free: shape (height, width), bool.
        goals: shape of `free`, bool: cells to be seen, all free.
        candidates: shape of `free`, bool: the cells in question, all free.
        reach: longest line [cells].
        name: of the world, for the progress bar.

    Returns:
        Shape of `free`, bool.
    """
    visible = goals.copy()
    skips, left = _skips(free, goals), _steps_to_goals(free, goals, min(math.ceil(reach), int(_FAR) - 1))
    with tqdm(total=len(free), desc=f"explorable area of {name}", unit="row", delay=_DELAY, leave=False) as bar:
        for first in range(0, len(free), _ROWS):
            last = min(first + _ROWS, len(free))
            _look(free, goals, candidates, skips, left, reach, first, last, visible)
            bar.update(last - first)
    return visible


@njit(cache=True, error_model="numpy", nogil=True)
def _skips(free, goals):
    """Return how many steps, to any side, lead no farther than to the first cell that is a goal, blocked or outside.

    Shape (height, width), uint8, at most 255.
    """
    height, width = free.shape
    steps = np.zeros((height, width), dtype=np.uint8)
    for row in range(height):
        for col in range(width):
            if free[row, col] and not goals[row, col]:
                least = 0
                if 0 < row < height - 1 and 0 < col < width - 1:
                    above = min(steps[row - 1, col - 1], steps[row - 1, col], steps[row - 1, col + 1])
                    least = min(above, steps[row, col - 1], 254)
                steps[row, col] = least + 1
    for row in range(height - 1, -1, -1):
        for col in range(width - 1, -1, -1):
            if steps[row, col] > 1:
                below = min(steps[row + 1, col - 1], steps[row + 1, col], steps[row + 1, col + 1])
                steps[row, col] = min(steps[row, col], min(below, steps[row, col + 1], 254) + 1)
    return steps


@njit(cache=True, error_model="numpy", nogil=True)
def _steps_to_goals(free, goals, reach):
    """Return the number of steps from each cell to the nearest goal through free cells, to any of the eight sides.

    Shape (height, width), uint16; `_FAR` beyond `reach`.
    """
    height, width = free.shape
    steps = np.full((height, width), _FAR, dtype=np.uint16)
    queue = np.empty(height * width, dtype=np.int32)
    end = 0
    for row in range(height):
        for col in range(width):
            if goals[row, col]:
                steps[row, col] = 0
                if _is_rim(free, goals, row, col):
                    queue[end] = row * width + col
                    end += 1
    begin = 0
    while begin < end:
        row, col = divmod(queue[begin], width)
        begin += 1
        following = steps[row, col] + 1
        if following > reach:
            break
        for i in range(max(row - 1, 0), min(row + 2, height)):
            for j in range(max(col - 1, 0), min(col + 2, width)):
                if free[i, j] and steps[i, j] == _FAR:
                    steps[i, j] = following
                    queue[end] = i * width + j
                    end += 1
    return steps


@njit(cache=True, error_model="numpy", nogil=True)
def _is_rim(free, goals, row, col):
    """Tell whether a goal has a free neighbour, to any of its eight sides, that is none."""
    for i in range(max(row - 1, 0), min(row + 2, free.shape[0])):
        for j in range(max(col - 1, 0), min(col + 2, free.shape[1])):
            if free[i, j] and not goals[i, j]:
                return True
    return False


@njit(cache=True, error_model="numpy", nogil=True)
def _look(free, goals, candidates, skips, left, reach, first, last, visible):
    """Mark in `visible` which candidates of the rows from `first` to `last` see a goal."""
    slopes = np.empty((NUM_DIRECTIONS, 2))
    lengths = np.empty(NUM_DIRECTIONS, dtype=np.int64)
    for k in range(NUM_DIRECTIONS):
        # The golden angle: any few directions in sequence look all around.
        slopes[k] = longest_step(2.399963229728653 * k)
        lengths[k] = int(reach / math.hypot(slopes[k, 0], slopes[k, 1]))
    latest = 0
    for row in range(first, last):
        for col in range(free.shape[1]):
            if candidates[row, col] and not visible[row, col] and left[row, col] != _FAR:
                # What was seen from the cell before is mostly seen from this one in the same direction.
                for k in range(latest, latest + NUM_DIRECTIONS):
                    k %= NUM_DIRECTIONS
                    if _sees(free, goals, skips, left, row, col, slopes[k], lengths[k]):
                        visible[row, col], latest = True, k
                        break


@njit(cache=True, error_model="numpy", nogil=True)
def _sees(free, goals, skips, left, row, col, slope, length):
    """Tell whether the line from a cell leads to a goal within `length` steps, through free cells only."""
    step = int(skips[row, col])
    while step <= length:
        i, j = cell_along(row, col, slope[0], slope[1], step)
        if i < 0 or j < 0 or i >= free.shape[0] or j >= free.shape[1] or not free[i, j]:
            return False
        if goals[i, j]:
            return True
        if left[i, j] > length - step:
            return False
        step += skips[i, j]
    return False

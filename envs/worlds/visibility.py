import math
from itertools import product

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry.lines import cell_along, longest_step
from lidarnaut.envs.progress import Progress

NUM_DIRECTIONS = 180
"""Number of directions of lines of sight from a cell."""
_HEIGHT, _WIDTH = 8, 128
"""Size of a block of cells that are tested at once [cells]; one byte holds eight cells of a column."""
_ROWS = 10 * _HEIGHT
_PROGRESS_DELAY = 2.0


def visible_from(
    free: np.ndarray, goals: np.ndarray, candidates: np.ndarray, reach: float, name: str = ""
) -> np.ndarray:
    """Return the mask of raster cells with a free line of sight to a cell of the mask `goals`, including `goals`.

    `free`, `candidates`: masks of free cells and cells to test, shape (height, width), bool; `reach`: maximum length of
    lines of sight [cells].
    """
    height = len(free)
    reach = min(reach, 2.0 * max(free.shape))  # longer lines leave the raster
    slopes, lengths, lines = _lines(reach)
    plain, ends = _pack(free & ~goals), _pack(goals)
    visible = goals.copy()
    label = f"explorable area of {name}"
    with Progress(total=8 * height, desc=label, unit="row", delay=_PROGRESS_DELAY, leave=False) as bar:
        for axis, sign, side in product((0, 1), (1, -1), (1, -1)):
            # In an octant, each step moves by `sign` along `axis`, and by `side` or 0 along the other axis.
            chosen = np.flatnonzero((slopes[:, axis] == sign) & ((slopes[:, 1 - axis] >= 0) == (side > 0)))
            straight, diagonal = ((sign, 0), (sign, side)) if axis == 0 else ((0, sign), (side, sign))
            wanted = _pack(candidates & ~visible & _comes_near(free, goals, straight, diagonal, reach))
            for first in range(0, height, _ROWS):
                last = min(first + _ROWS, height)
                _look(plain, ends, wanted, lengths[chosen], lines[chosen], first, last, visible)
                bar.update(last - first)
    return visible


@njit(cache=True, error_model="numpy", nogil=True)
def _comes_near(free, goals, straight, diagonal, reach):
    """Return the mask of cells that are at most `reach` steps through free cells from a cell of the mask `goals`."""
    height, width = free.shape
    far = np.uint16(2**16 - 2)
    near = np.empty((height, width), dtype=np.bool_)
    # Steps to a goal in this row and in the previous row, padded.
    line, before = np.full(width + 2, far, dtype=np.uint16), np.full(width + 2, far, dtype=np.uint16)
    by_row, by_col = diagonal
    for k in range(height):
        row = height - 1 - k if by_row > 0 else k
        line, before = before, line
        aslant = before[1 + by_col :]
        ahead = aslant if straight[0] == 0 else before[1:]
        is_free, is_goal, steps = free[row], goals[row], line[1:]
        for col in range(width):
            least = min(min(ahead[col], aslant[col]) + 1, far) if is_free[col] else far
            steps[col] = 0 if is_goal[col] else least
        if straight[0] == 0:
            latest = far
            for n in range(width):
                col = width - 1 - n if by_col > 0 else n
                if is_free[col]:
                    steps[col] = min(steps[col], min(latest + 1, far))
                latest = steps[col]
        for col in range(width):
            near[row, col] = steps[col] <= reach and steps[col] < far
    return near


@njit(cache=True, error_model="numpy", nogil=True)
def _lines(reach):
    slopes = np.empty((NUM_DIRECTIONS, 2))
    lengths = np.empty(NUM_DIRECTIONS, dtype=np.int64)
    lines = np.empty((NUM_DIRECTIONS, int(reach) + 1, 2), dtype=np.int64)
    for k in range(NUM_DIRECTIONS):
        # Golden angle: consecutive directions cover the circle.
        d_row, d_col = longest_step(2.399963229728653 * k)
        slopes[k, 0], slopes[k, 1] = d_row, d_col
        lengths[k] = int(reach / math.hypot(d_row, d_col))
        for step in range(lengths[k] + 1):
            lines[k, step, 0], lines[k, step, 1] = cell_along(0, 0, d_row, d_col, step)
    return slopes, lengths, lines


@njit(cache=True, error_model="numpy", nogil=True)
def _pack(mask):
    """Pack a mask into bytes, each with eight cells of a column, with a border of zeros."""
    height, width = mask.shape
    packed = np.zeros((height + 2 * _HEIGHT, width + 2 * _WIDTH), dtype=np.uint8)
    for row in range(height - 1, -_HEIGHT, -1):
        line, below = packed[row + _HEIGHT, _WIDTH:], packed[row + _HEIGHT + 1, _WIDTH:]
        for col in range(width):
            line[col] = below[col] << 1
        if row >= 0:
            for col in range(width):
                line[col] |= mask[row, col]
    return packed


@njit(cache=True, error_model="numpy", nogil=True)
def _look(plain, ends, wanted, lengths, lines, first, last, visible):
    height, width = visible.shape
    left, alive = np.empty(_WIDTH, dtype=np.uint8), np.empty(_WIDTH, dtype=np.uint8)
    for top in range(first, last, _HEIGHT):
        for start in range(0, width, _WIDTH):
            asked = wanted[top + _HEIGHT, start + _WIDTH : start + 2 * _WIDTH]
            if not asked.any():
                continue
            for j in range(_WIDTH):  # slices compile slowly
                left[j] = asked[j]
            for k in range(lengths.shape[0]):
                if not left.any():
                    break
                for j in range(_WIDTH):
                    alive[j] = left[j]
                for step in range(1, lengths[k] + 1):
                    row, col = top + _HEIGHT + lines[k, step, 0], start + _WIDTH + lines[k, step, 1]
                    if not (0 < row < height + _HEIGHT and 0 < col < width + _WIDTH):
                        break
                    if not _advance(plain[row, col : col + _WIDTH], ends[row, col : col + _WIDTH], alive, left):
                        break
            for j in range(min(_WIDTH, width - start)):
                seen = asked[j] & ~left[j]
                for bit in range(_HEIGHT):
                    if seen >> bit & 1:
                        visible[top + bit, start + j] = True


@njit(cache=True, error_model="numpy", nogil=True)
def _advance(plain, ends, alive, left):
    remain = np.uint8(0)
    for j in range(_WIDTH):
        left[j] &= ~(alive[j] & ends[j])
        alive[j] &= plain[j]
        remain |= alive[j]
    return remain != 0

"""Map crops around a robot at several resolutions that preserve thin walls."""

import math
from typing import Any

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.estimation.belief import MapUpdate
from lidarnaut.envs.estimation.trail import Trail
from lidarnaut.envs.geometry import NO_WINDOW, OCCUPIED_FROM, OccupancyGrid, Window
from lidarnaut.envs.geometry.lookup import load

LARGEST_POOLED = 8
"""Pyramid blocks up to this side are computed from map cells, larger blocks from smaller blocks [cells]."""
_POOL = 4
_FREE = np.uint16(0xFF)
_OCCUPIED = np.uint16(1 << 8)
_VISITED = np.uint16(1 << 9)


@njit(cache=True, error_model="numpy")
def _add_columns(lines, sums):
    for k in range(sums.shape[0]):
        sums[k] = np.uint16(0)
    for row in range(lines.shape[0]):
        line = lines[row]
        for k in range(line.shape[0]):
            known = np.uint16(1) if line[k] >= 0 else np.uint16(0)
            sums[k] += known + (np.uint16(255) if line[k] >= OCCUPIED_FROM else np.uint16(0))


@njit(cache=True, error_model="numpy")
def pool_window(data, window, block, level):
    """Compute the blocks of a pyramid level inside a rectangle of the map; other arguments as in `pool_cells`."""
    level_width = (data.shape[1] + block - 1) // block
    first, last = window.col // block, (window.col + window.width - 1) // block + 1
    sums, scale = np.empty((last - first) * block, dtype=np.uint16), np.float32(1.0 / (block * block))
    for i in range(window.row // block, (window.row + window.height - 1) // block + 1):
        _add_columns(data[i * block : (i + 1) * block, first * block : last * block], sums)
        words = level[i * level_width + first : i * level_width + last]
        for k in range(words.shape[0]):
            total = np.uint16(0)
            for j in range(k * block, (k + 1) * block):
                total += sums[j]
            share = np.uint16((np.float32(np.uint16(255) * (total & _FREE)) + np.float32(0.5)) * scale)
            words[k] = (words[k] & _VISITED) | (_OCCUPIED if total >= _OCCUPIED else np.uint16(0)) | share


@njit(cache=True, error_model="numpy")
def pool_cells(data, cells, block, level):
    """Compute the blocks of a pyramid level that contain changed map cells.

    `data`: occupancy [percent], shape (height, width), int8; `cells`: rows and columns, shape (n, 2), int32; `block`:
    side of a block [cells], a power of two up to `LARGEST_POOLED`; `level`: output, one uint16 per block: fraction of
    free cells times 255, and bits for occupied and visited.
    """
    height, width = data.shape
    level_width, last_i, last_j = (width + block - 1) // block, -1, -1
    bits, scale = round(math.log2(block)), np.float32(1.0 / (block * block))
    for k in range(cells.shape[0]):
        i, j = cells[k, 0] >> bits, cells[k, 1] >> bits
        if i != last_i or j != last_j:
            known = occupied = 0
            for a in range(i << bits, min((i + 1) << bits, height)):
                for b in range(j << bits, min((j + 1) << bits, width)):
                    known += data[a, b] >= 0
                    occupied += data[a, b] >= OCCUPIED_FROM
            # Half a cell compensates rounding errors.
            share = np.uint16((np.float32(255 * (known - occupied)) + np.float32(0.5)) * scale)
            at = i * level_width + j
            level[at] = (level[at] & _VISITED) | (_OCCUPIED if occupied > 0 else np.uint16(0)) | share
        last_i, last_j = i, j


@njit(cache=True, error_model="numpy")
def _pool_blocks(finer, height, width, cells, block, level):
    level_width, last_i, last_j, bits = (width + _POOL - 1) // _POOL, -1, -1, round(math.log2(block))
    for k in range(cells.shape[0]):
        i, j = cells[k, 0] >> bits, cells[k, 1] >> bits
        if i != last_i or j != last_j:
            free, marks = 0, np.uint16(0)
            for a in range(i * _POOL, min((i + 1) * _POOL, height)):
                for b in range(j * _POOL, min((j + 1) * _POOL, width)):
                    word = finer[a * width + b]
                    free += word & _FREE
                    marks |= word & (_OCCUPIED | _VISITED)
            level[i * level_width + j] = marks | free // (_POOL * _POOL)
        last_i, last_j = i, j


def corners(window: Window, block: int) -> np.ndarray:
    """Return one cell (row, column) of each block of `block` x `block` cells in a rectangle, shape (n, 2), int32."""
    sides = (window.row, window.height), (window.col, window.width)
    lines = [np.arange(first - first % block, first + size, block, dtype=np.int32) for first, size in sides]
    return np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 2)


@njit(cache=True, error_model="numpy")
def crop_level(level, height, width, x, y, theta, pixel, crop):
    """Write a square map crop from a pyramid level, centred at the robot and turned to its heading.

    `crop`: output, shape (3, size, size), uint8: occupied (255), fraction of free cells times 255, visited (255); axis
    1 points forward, axis 2 left. `level`: block values from `pool_cells`; `x`, `y`, `theta`: robot pose relative to
    the map's corner [blocks, blocks, rad]; `pixel`: side of a pixel [blocks].
    """
    size = crop.shape[1]
    c, s = np.float32(math.cos(theta) * pixel), np.float32(math.sin(theta) * pixel)
    rows, cols = np.float32(height), np.float32(width)
    middle = np.float32(0.5 * size - 0.5)
    x32, y32 = np.float32(x), np.float32(y)
    indices = np.empty(size, dtype=np.uint32)
    outside = np.uint32(height * width)
    for i in range(size):
        u = np.float32(i) - middle
        first_col, first_row = x32 + c * u, y32 + s * u
        for j in range(size):
            v = np.float32(j) - middle
            col, row = first_col - s * v, first_row + c * v
            inside = (col >= 0) & (row >= 0) & (col < cols) & (row < rows)
            indices[j] = np.int32(row) * np.int32(width) + np.int32(col) if inside else outside
        for j in range(size):
            word = load(level, indices[j])
            crop[0, i, j] = 255 if word & _OCCUPIED else 0
            crop[1, i, j] = word & _FREE
            crop[2, i, j] = 255 if word & _VISITED else 0


class Level:
    """Level of a map pyramid: the map divided into square blocks of one size."""

    def __init__(self, block: int, finer: "Level | None") -> None:
        """Create a pyramid level of blocks with side `block` [cells].

        Blocks are computed from the blocks of the level `finer`, or from map cells if None.
        """
        self.block, self.finer = block, finer
        self.is_stale = True

    def rebuild(self, data: np.ndarray) -> None:
        self.height, self.width = (math.ceil(size / self.block) for size in data.shape)
        self.words = np.zeros(self.height * self.width + 1, dtype=np.uint16)
        self.update(data, Window(0, 0, *data.shape), None)

    def update(self, data: np.ndarray, window: Window, cells: np.ndarray | None) -> None:
        """Update the blocks of changed map cells (row, column), shape (n, 2), int32; None: all cells of a window."""
        is_many = cells is None or len(cells) * self.block**2 > window.height * window.width
        if (finer := self.finer) is not None:
            changed = corners(window, self.block) if cells is None or is_many else cells
            _pool_blocks(finer.words, finer.height, finer.width, changed, self.block, self.words)
        elif is_many:
            pool_window(data, window, self.block, self.words)
        else:
            pool_cells(data, cells, self.block, self.words)

    def mark(self, col: float, row: float) -> None:
        """Mark the level's block at map cell (`col`, `row`) as visited by the robot."""
        i, j = math.floor(row) // self.block, math.floor(col) // self.block
        if 0 <= i < self.height and 0 <= j < self.width:
            self.words[i * self.width + j] |= _VISITED


class MapPyramid:
    """Pyramid of an occupancy map, for map crops at several resolutions. Levels are computed on demand."""

    def __init__(self, grid: OccupancyGrid, trails: list[Trail]) -> None:
        self.grid, self._data, self._trails = grid, grid.data, trails
        self._levels: dict[int, Level] = {}  # finer ones first
        self._window, self._changed = NO_WINDOW, list[Any]()  # since the last crop; None for an unknown list of cells
        self.revision = object()
        """Object that stands for the contents of the map, and is replaced by `update`."""

    def update(self, update: MapUpdate) -> None:
        data, changed_cells, self.revision = self.grid.data, update.changed_cells, object()
        if update.redrawn or data is not self._data:
            self._data, self._window, self._changed = data, NO_WINDOW, []
            for level in self._levels.values():
                level.is_stale = True
        elif update.window is not None and self._levels:
            self._window = update.window.union(self._window)
            is_known = changed_cells is not None and update.origin == self.grid.origin
            self._changed += [update.new_cells, changed_cells] if is_known else [None]

    def mark(self, x: float, y: float) -> None:
        col, row = self._in_cells(x, y)
        for level in self._levels.values():
            if not level.is_stale:
                level.mark(col, row)

    def level(self, pixel: float) -> Level:
        """Return the up-to-date pyramid level whose block side is nearest to `pixel` [m]."""
        level = self._level(2 ** max(round(math.log2(pixel / self.grid.resolution)), 0))
        self._refresh()
        return level

    def _level(self, block: int) -> Level:
        if block not in self._levels:
            finer = self._level(block // _POOL) if block > LARGEST_POOLED else None
            self._levels[block] = Level(block, finer)
        return self._levels[block]

    def _refresh(self) -> None:
        is_known = all(cells is not None for cells in self._changed)
        cells = np.concatenate(self._changed) if self._changed and is_known else None
        for level in self._levels.values():
            if level.is_stale:
                level.rebuild(self.grid.data)
                for trail in self._trails:
                    for x, y in trail.positions.tolist():
                        level.mark(*self._in_cells(x, y))
                level.is_stale = False
            elif self._changed:
                level.update(self.grid.data, self._window, cells)
        self._window, self._changed = NO_WINDOW, []

    def _in_cells(self, x: float, y: float) -> tuple[float, float]:
        grid, (left, low) = self.grid, self.grid.origin
        return (x - left) / grid.resolution, (y - low) / grid.resolution

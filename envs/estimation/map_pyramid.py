"""Map crops around a robot at several resolutions that preserve thin walls."""

import math

import numpy as np
from numba import njit

from lidarnaut.envs.estimation.belief import MapUpdate
from lidarnaut.envs.estimation.trail import Trail
from lidarnaut.envs.geometry import NO_WINDOW, OCCUPIED_FROM, OccupancyGrid, Window
from lidarnaut.envs.geometry.lookup import load

LARGEST_POOLED = 8
"""Pyramid blocks up to this side are computed from map cells, larger blocks from smaller blocks [cells]."""
CELLS_PER_CHANGE = 16
"""Changed cells are pooled one by one if the map rectangle around them has at least this many cells for each."""
_POOL = 4
_FREE = np.uint16(0xFF)
_OCCUPIED = np.uint16(1 << 8)
_VISITED = np.uint16(1 << 9)


@njit(cache=True, error_model="numpy", inline="always")
def _counted(value):
    return (np.uint16(1) if value >= 0 else np.uint16(0)) + (np.uint16(255) if value >= OCCUPIED_FROM else np.uint16(0))


@njit(cache=True, error_model="numpy")
def _add_columns(lines, sums):
    for k in range(sums.shape[0]):
        sums[k] = np.uint16(0)
    for row in range(lines.shape[0]):
        line = lines[row]
        for k in range(line.shape[0]):
            sums[k] += _counted(line[k])


@njit(cache=True, error_model="numpy", inline="always")
def _pooled(word, total, scale):
    # Half a cell compensates rounding errors.
    share = np.uint16((np.float32(np.uint16(255) * (total & _FREE)) + np.float32(0.5)) * scale)
    return (word & _VISITED) | (_OCCUPIED if total >= _OCCUPIED else np.uint16(0)) | share


@njit(cache=True, error_model="numpy")
def pool_cells(data, window, block, level):
    """Compute the blocks of a pyramid level inside a changed rectangle of the map.

    `data`: occupancy [percent], shape (height, width), int8; `window`: changed rectangle; `block`: side of a block
    [cells], a power of two up to `LARGEST_POOLED`; `level`: output, one uint16 per block: fraction of free cells times
    255, and bits for occupied and visited.
    """
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
            words[k] = _pooled(words[k], total, scale)


@njit(cache=True, error_model="numpy")
def pool_at(data, cells, block, level):
    """Compute the blocks of a pyramid level that contain map cells (row, column), shape (n, 2), int32.

    Other arguments as in `pool_cells`.
    """
    height, width = data.shape
    level_width, scale, last_i, last_j = (width + block - 1) // block, np.float32(1.0 / (block * block)), -1, -1
    for k in range(cells.shape[0]):
        i, j = cells[k, 0] // block, cells[k, 1] // block
        if i != last_i or j != last_j:
            total = np.uint16(0)
            for a in range(i * block, min((i + 1) * block, height)):
                for b in range(j * block, min((j + 1) * block, width)):
                    total += _counted(data[a, b])
            level[i * level_width + j] = _pooled(level[i * level_width + j], total, scale)
        last_i, last_j = i, j


@njit(cache=True, error_model="numpy")
def _pool_block(finer, height, width, i, j):
    free = 0
    marks = np.uint16(0)
    for a in range(i * _POOL, min((i + 1) * _POOL, height)):
        for b in range(j * _POOL, min((j + 1) * _POOL, width)):
            word = finer[a * width + b]
            free += word & _FREE
            marks |= word & (_OCCUPIED | _VISITED)
    return marks | free // (_POOL * _POOL)


@njit(cache=True, error_model="numpy")
def _pool_blocks(finer, height, width, window, level):
    level_width = (width + _POOL - 1) // _POOL
    for i in range(window.row // _POOL, (window.row + window.height - 1) // _POOL + 1):
        for j in range(window.col // _POOL, (window.col + window.width - 1) // _POOL + 1):
            level[i * level_width + j] = _pool_block(finer, height, width, i, j)


@njit(cache=True, error_model="numpy")
def _pool_blocks_at(finer, height, width, cells, block, level):
    level_width, last_i, last_j = (width + _POOL - 1) // _POOL, -1, -1
    for k in range(cells.shape[0]):
        i, j = cells[k, 0] // block, cells[k, 1] // block
        if i != last_i or j != last_j:
            level[i * level_width + j] = _pool_block(finer, height, width, i, j)
        last_i, last_j = i, j


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
        self.update(data, Window(0, 0, *data.shape))

    def update(self, data: np.ndarray, window: Window, cells: np.ndarray | None = None) -> None:
        """Update the blocks of changed map cells, shape (n, 2), int32; by default, of all cells of `window`."""
        if self.finer is not None:
            finer = self.finer.words, self.finer.height, self.finer.width
            if cells is None:
                _pool_blocks(*finer, window.blocks(self.finer.block), self.words)
            else:
                _pool_blocks_at(*finer, cells, self.block, self.words)
        elif cells is None:
            pool_cells(data, window, self.block, self.words)
        else:
            pool_at(data, cells, self.block, self.words)

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
        self._window = NO_WINDOW  # changed since `_refresh`
        self._cells: list[np.ndarray] | None = []  # changed since `_refresh`; None if too many

    def update(self, update: MapUpdate) -> None:
        data = self.grid.data
        if update.redrawn or data is not self._data:
            self._data = data
            for level in self._levels.values():
                level.is_stale = True
        elif update.window is not None:
            self._window = update.window.union(self._window)
            if update.changed_cells is None or self._cells is None or update.origin != self.grid.origin:
                self._cells = None
                return
            self._cells += [update.new_cells, update.changed_cells]
            if CELLS_PER_CHANGE * sum(map(len, self._cells)) > self._window.height * self._window.width:
                self._cells = None

    def mark(self, x: float, y: float) -> None:
        col, row = self._in_cells(x, y)
        for level in self._levels.values():
            if not level.is_stale:
                level.mark(col, row)

    def crop(self, x: float, y: float, theta: float, pixel: float, out: np.ndarray) -> None:
        """Write a square map crop around a pose (map frame) to `out`, with pixels of side `pixel` [m].

        `out`: shape (3, size, size), uint8: occupied, free, visited.
        """
        level = self.level(pixel)
        side = level.block * self.grid.resolution
        left, low = self.grid.origin
        x, y = (x - left) / side, (y - low) / side
        crop_level(level.words, level.height, level.width, x, y, theta, pixel / side, out)

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
        data, window = self.grid.data, self._window
        cells = np.concatenate(self._cells) if self._cells else None
        for level in self._levels.values():
            if level.is_stale:
                level.rebuild(data)
                for trail in self._trails:
                    for x, y in trail.positions.tolist():
                        level.mark(*self._in_cells(x, y))
            elif not window.is_empty:
                level.update(data, window, cells)
            level.is_stale = False
        self._window, self._cells = NO_WINDOW, []

    def _in_cells(self, x: float, y: float) -> tuple[float, float]:
        grid, (left, low) = self.grid, self.grid.origin
        return (x - left) / grid.resolution, (y - low) / grid.resolution

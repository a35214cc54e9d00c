"""The believed map at the scales at which a policy sees it, kept up to date as it is drawn.

A block of the pyramid's near level covers as many map cells as a pixel of `map_near`, one of the far level 4 x 4 near
blocks. A crop then costs one look-up per pixel, and no wall is lost between look-ups, however thin it is.
"""

import math

import numpy as np
from numba import njit

from envs.geometry import OccupancyGrid
from envs.geometry.lookup import load

CROP_SIZE = 40
"""Side of a map crop [pixels]."""
NEAR_PIXEL = 0.2
"""Side of a pixel of `map_near` [m]."""
FAR_PIXEL = 0.8
"""Side of a pixel of `map_far` [m]."""
OCCUPIED_FROM = 50
"""Least occupancy at which a cell counts as occupied [percent]."""

_POOL = round(FAR_PIXEL / NEAR_PIXEL)
_FREE = np.uint16(0xFF)
_OCCUPIED = np.uint16(1 << 8)
_VISITED = np.uint16(1 << 9)


def block_size(resolution: float) -> int:
    """Return how many map cells of side `resolution` [m] a near block has along each axis: 1, 2, 4 or 8."""
    return 2 ** min(max(round(math.log2(NEAR_PIXEL / resolution)), 0), 3)


@njit(cache=True, error_model="numpy")
def level_size(cells, block):
    """Return how many blocks of `block` cells it takes to cover `cells` cells."""
    return (cells + block - 1) // block


@njit(cache=True, error_model="numpy")
def _add_columns(lines, sums):
    """Write to `sums`, shape (n,), uint16, what stands in each column of `lines`: free cells + 256 x occupied ones."""
    for k in range(sums.shape[0]):
        sums[k] = np.uint16(0)
    for row in range(lines.shape[0]):
        line = lines[row]
        for k in range(line.shape[0]):
            known = np.uint16(1) if line[k] >= 0 else np.uint16(0)
            sums[k] += known + (np.uint16(255) if line[k] >= OCCUPIED_FROM else np.uint16(0))


@njit(cache=True, error_model="numpy")
def _add_pairs(sums, pairs):
    """Write the sums of neighbours to `pairs`, shape (n,), uint16."""
    for k in range(pairs.shape[0]):
        left = np.uint32(2 * k)
        pairs[k] = sums[left] + sums[left + np.uint32(1)]


@njit(cache=True, error_model="numpy")
def _write_words(sums, block, words):
    """Turn the sums of blocks into their words."""
    scale = np.float32(1.0 / (block * block))
    for k in range(words.shape[0]):
        # Half a cell more keeps what single precision loses from rounding a whole number down.
        share = np.uint16((np.float32(np.uint16(255) * (sums[k] & _FREE)) + np.float32(0.5)) * scale)
        words[k] = (words[k] & _VISITED) | (_OCCUPIED if sums[k] >= _OCCUPIED else np.uint16(0)) | share


@njit(cache=True, error_model="numpy")
def pool_map(data, col_min, row_min, col_max, row_max, block, near, far):
    """Bring the pyramid up to date where the map may have changed.

    Args:
        data: shape (height, width), int8, occupancy.
        col_min: first column that may have changed.
        row_min: first row that may have changed.
        col_max: last column that may have changed.
        row_max: last row that may have changed.
        block: side of a near block [cells].
        near: shape (n + 1,), uint16, written: the words of n near blocks row by row, and 0 for everything outside.
        far: the same of the far level.
    """
    height, width = data.shape
    near_width, near_height = level_size(width, block), level_size(height, block)
    far_width = level_size(near_width, _POOL)
    first, last = col_min // block, col_max // block + 1
    sums, pairs = np.empty((last - first) * block, dtype=np.uint16), np.empty((last - first) * block, dtype=np.uint16)
    for i in range(row_min // block, row_max // block + 1):
        _add_columns(data[i * block : (i + 1) * block, first * block : last * block], sums)
        count = sums.shape[0]
        while count > last - first:
            count //= 2
            _add_pairs(sums, pairs[:count])
            sums, pairs = pairs, sums
        _write_words(sums, block, near[i * near_width + first : i * near_width + last])
    for i in range(row_min // block // _POOL, row_max // block // _POOL + 1):
        for j in range(col_min // block // _POOL, col_max // block // _POOL + 1):
            free = 0
            marks = np.uint16(0)
            for a in range(i * _POOL, min((i + 1) * _POOL, near_height)):
                for b in range(j * _POOL, min((j + 1) * _POOL, near_width)):
                    word = near[a * near_width + b]
                    free += word & _FREE
                    marks |= word & (_OCCUPIED | _VISITED)
            far[i * far_width + j] = marks | free // (_POOL * _POOL)


@njit(cache=True, error_model="numpy")
def mark_visited(x, y, height, width, block, near, far):
    """Remember that the robot has been at a position, given from the map's corner [cells]; see `pool_map`."""
    i, j = math.floor(y) // block, math.floor(x) // block
    near_width, near_height = level_size(width, block), level_size(height, block)
    if 0 <= i < near_height and 0 <= j < near_width:
        near[i * near_width + j] |= _VISITED
        far[i // _POOL * level_size(near_width, _POOL) + j // _POOL] |= _VISITED


@njit(cache=True, error_model="numpy")
def crop_level(level, height, width, x, y, theta, pixel, crop):
    """Look at a level from the robot: axis 1 of `crop` points forward, axis 2 to the left, the robot in the middle.

    Args:
        level: shape (height * width + 1,), uint16; see `pool_map`.
        height: rows of the level [blocks].
        width: columns of the level [blocks].
        x: believed position of the robot from the map's corner [blocks].
        y: the same [blocks].
        theta: believed heading [rad].
        pixel: side of a crop pixel [blocks].
        crop: shape (3, size, size), uint8, written: 255 where the block in the middle of the pixel has an occupied
            cell; the share of its cells that are free, times 255; 255 where the robot has been in it.
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


@njit(cache=True, error_model="numpy")
def crop_pyramid(near, far, height, width, block, resolution, x, y, theta, crop_near, crop_far):
    """Look at both levels of the pyramid of a map from the robot.

    Args:
        near: see `pool_map`.
        far: see `pool_map`.
        height: rows of the map [cells].
        width: columns of the map [cells].
        block: side of a near block [cells].
        resolution: side of a map cell [m].
        x: believed position of the robot from the map's corner [m].
        y: the same [m].
        theta: believed heading [rad].
        crop_near: shape (3, size, size), uint8, written; see `crop_level`.
        crop_far: the same.
    """
    side = block * resolution
    near_height, near_width = level_size(height, block), level_size(width, block)
    crop_level(near, near_height, near_width, x / side, y / side, theta, NEAR_PIXEL / side, crop_near)
    side *= _POOL
    far_height, far_width = level_size(near_height, _POOL), level_size(near_width, _POOL)
    crop_level(far, far_height, far_width, x / side, y / side, theta, FAR_PIXEL / side, crop_far)


class MapPyramid:
    """Both levels of one map."""

    def __init__(self, grid: OccupancyGrid) -> None:
        """Pool a map in which the robot has not been anywhere yet."""
        self.rebuild(grid, np.empty((0, 2)))

    def rebuild(self, grid: OccupancyGrid, visited: np.ndarray) -> None:
        """Pool the whole of a map that is new or has grown.

        Args:
            grid: the map.
            visited: shape (n, 2), float64, where the robot has been (x, y), map frame [m].
        """
        self._grid, self._data = grid, grid.data
        self.block = block_size(grid.resolution)
        """Side of a near block [cells]."""
        height, width = grid.data.shape
        near_height, near_width = level_size(height, self.block), level_size(width, self.block)
        far_size = level_size(near_height, _POOL) * level_size(near_width, _POOL)
        self.near = np.zeros(near_height * near_width + 1, dtype=np.uint16)
        """Shape (n + 1,), uint16; see `pool_map`."""
        self.far = np.zeros(far_size + 1, dtype=np.uint16)
        """The same of the far level."""
        pool_map(grid.data, 0, 0, width - 1, height - 1, self.block, self.near, self.far)
        for x, y in visited:
            self.mark(x, y)

    def update(self, touched: tuple[int, int, int, int] | None, visited: np.ndarray) -> None:
        """Follow the map.

        Args:
            touched: as `Belief.touched`.
            visited: as in `rebuild`; looked at if the map has grown.
        """
        if self._grid.data is not self._data:
            self.rebuild(self._grid, visited)
        elif touched is not None:
            pool_map(self._grid.data, *touched, self.block, self.near, self.far)

    def mark(self, x: float, y: float) -> None:
        """Remember that the robot has been at (x, y), map frame [m]."""
        grid, (left, low) = self._grid, self._grid.origin
        height, width = grid.data.shape
        col, row = (x - left) / grid.resolution, (y - low) / grid.resolution
        mark_visited(col, row, height, width, self.block, self.near, self.far)

    def crop(self, x: float, y: float, theta: float, near: np.ndarray, far: np.ndarray) -> None:
        """Look at the map from a pose in the map frame; `near` and `far` are written, see `crop_level`."""
        grid, (left, low) = self._grid, self._grid.origin
        height, width = grid.data.shape
        frame = (height, width, self.block, grid.resolution, x - left, y - low, theta)
        crop_pyramid(self.near, self.far, *frame, near, far)

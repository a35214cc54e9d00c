"""What a lidar sees of a true map from its cells, as sets of samples."""

import math

import numpy as np
from numba import njit

from envs.geometry.lines import cell_along, longest_step


@njit(cache=True, error_model="numpy")
def _view(free, row, col, reach, sample_of, words):
    """Set the bits of the samples that straight lines from a cell's centre meet before anything that is not free.

    The lines end one cell apart on a circle, and are followed from cell to cell along their longer axis.

    Args:
        free: shape (height, width), bool; no free cell lies at the edge.
        row: row of the cell.
        col: column of the cell.
        reach: length of the lines [cells].
        sample_of: shape (height, width), int32, index of a cell's sample, -1 for none.
        words: shape (words,), uint64, changed.
    """
    if sample_of[row, col] >= 0:
        words[sample_of[row, col] >> 6] |= np.uint64(1) << np.uint64(sample_of[row, col] & 63)
    height, width = free.shape
    num_lines = max(8, math.ceil(2.0 * math.pi * reach))
    for k in range(num_lines):
        d_row, d_col = longest_step(2.0 * math.pi * k / num_lines)
        for step in range(1, int(reach / math.hypot(d_row, d_col)) + 1):
            i, j = cell_along(row, col, d_row, d_col, step)
            if i < 0 or j < 0 or i >= height or j >= width or not free[i, j]:
                break
            sample = sample_of[i, j]
            if sample >= 0:
                words[sample >> 6] |= np.uint64(1) << np.uint64(sample & 63)


@njit(cache=True, error_model="numpy")
def _views(free, cells, reach, sample_of, num_words):
    views = np.zeros((cells.shape[0], num_words), dtype=np.uint64)
    for k in range(cells.shape[0]):
        _view(free, cells[k, 0], cells[k, 1], reach, sample_of, views[k])
    return views


def views_from(free: np.ndarray, cells: np.ndarray, reach: float, samples: np.ndarray) -> np.ndarray:
    """Tell which samples are seen from cells by a lidar that looks all around.

    Args:
        free: shape (height, width), bool.
        cells: shape (n, 2), int64, (row, column) of the viewpoints.
        reach: range [cells].
        samples: shape (s, 2), int64, (row, column) of what is looked for.

    Returns:
        Shape (n, ceil(s / 64)), uint64: bit i % 64 of word i // 64 is set where sample i is seen.
    """
    sample_of = np.full(free.shape, -1, dtype=np.int32)
    sample_of[tuple(samples.T)] = np.arange(len(samples))
    views: np.ndarray = _views(free, np.ascontiguousarray(cells), float(reach), sample_of, -(-len(samples) // 64))
    return views


def pack_bits(flags: np.ndarray) -> np.ndarray:
    """Pack flags (shape (s,), bool) into words as `views_from` does: shape (ceil(s / 64),), uint64."""
    padded = np.zeros(-(-len(flags) // 64) * 64, dtype=bool)
    padded[: len(flags)] = flags
    words: np.ndarray = np.packbits(padded, bitorder="little").view("<u8").astype(np.uint64)
    return words


def unpack_bits(words: np.ndarray, num_flags: int) -> np.ndarray:
    """Unpack what `pack_bits` has packed: shape (num_flags,), bool."""
    return np.unpackbits(words.astype("<u8").view(np.uint8), count=num_flags, bitorder="little").astype(bool)

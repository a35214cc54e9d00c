"""What can be seen from which viewpoint of a known map, and along the paths between viewpoints, as sets of samples."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from envs.geometry.lines import cell_along, longest_step


class Cover(NamedTuple):
    """What there is to plan over: n viewpoints, s samples of the area to see in words of 64 bits."""

    lengths: np.ndarray
    """Shape (n, n), float64, finite, symmetric: path lengths between viewpoints [m]."""
    predecessors: np.ndarray
    """Shape (n, n), int32: `predecessors[i, j]` is the last viewpoint before j on the path from i, or i itself."""
    near: np.ndarray
    """Shape (n, k), int32: the viewpoints nearest to each, itself left out."""
    sees: np.ndarray
    """Shape (n, words), uint64: a bit per sample that is seen from a viewpoint."""


@njit(cache=True, error_model="numpy", inline="always")
def ones(word):
    """Count the bits of a word that are set (Warren, Hacker's Delight, section 5-1)."""
    word = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
    word = (word & np.uint64(0x3333333333333333)) + ((word >> np.uint64(2)) & np.uint64(0x3333333333333333))
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return np.int64((word * np.uint64(0x0101010101010101)) >> np.uint64(56))


@njit(cache=True, error_model="numpy")
def count_bits(words):
    """Count the bits of words (shape (n,), uint64) that are set."""
    total = 0
    for word in words:
        total += ones(word)
    return total


@njit(cache=True, error_model="numpy")
def add_views(cover, first, last, seen):
    """Add to `seen` what is seen on the path from one viewpoint (excluded) to another (included)."""
    viewpoint = last
    while viewpoint != first:
        for w in range(seen.size):
            seen[w] |= cover.sees[viewpoint, w]
        viewpoint = cover.predecessors[first, viewpoint]


@njit(cache=True, error_model="numpy")
def seen_on(cover, known, tour):
    """Return what is known after a tour: `known` (shape (words,), uint64) and all that is seen on it."""
    seen = known.copy()
    for k in range(tour.size - 1):
        add_views(cover, tour[k], tour[k + 1], seen)
    return seen


@njit(cache=True, error_model="numpy")
def _add_bit(words, bit):
    if bit >= 0:
        words[bit >> 6] |= np.uint64(1) << np.uint64(bit & 63)


@njit(cache=True, error_model="numpy")
def _views(free, cells, reach, sample_of, num_words):
    """Follow straight lines from each cell's centre until they meet anything that is not free; see `views_from`.

    The lines end one cell apart on a circle, and are followed from cell to cell along their longer axis.
    """
    height, width = free.shape
    views = np.zeros((len(cells), num_words), dtype=np.uint64)
    num_lines = max(8, math.ceil(2.0 * math.pi * reach))
    for n in range(len(cells)):
        row, col = cells[n]
        _add_bit(views[n], sample_of[row, col])
        for k in range(num_lines):
            d_row, d_col = longest_step(2.0 * math.pi * k / num_lines)
            for step in range(1, int(reach / math.hypot(d_row, d_col)) + 1):
                i, j = cell_along(row, col, d_row, d_col, step)
                if i < 0 or j < 0 or i >= height or j >= width or not free[i, j]:
                    break
                _add_bit(views[n], sample_of[i, j])
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
    padded = np.pad(flags, (0, -len(flags) % 64))
    words: np.ndarray = np.packbits(padded, bitorder="little").view("<u8").astype(np.uint64)
    return words


def unpack_bits(words: np.ndarray, num_flags: int) -> np.ndarray:
    """Unpack what `pack_bits` has packed: shape (num_flags,), bool."""
    return np.unpackbits(words.astype("<u8").view(np.uint8), count=num_flags, bitorder="little").astype(bool)

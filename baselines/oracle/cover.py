"""What can be seen from which viewpoint of a known map, and along the paths between viewpoints."""

from typing import NamedTuple

import numpy as np
from numba import njit


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
def length_of(cover, tour):
    """Sum the lengths along a tour [m]."""
    total = 0.0
    for k in range(tour.size - 1):
        total += cover.lengths[tour[k], tour[k + 1]]
    return total


@njit(cache=True, error_model="numpy")
def seen_on(cover, known, tour):
    """Return what is known after a tour: `known` (shape (words,), uint64) and all that is seen on it."""
    seen = known.copy()
    for k in range(tour.size - 1):
        add_views(cover, tour[k], tour[k + 1], seen)
    return seen

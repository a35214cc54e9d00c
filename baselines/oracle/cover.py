"""What can be seen of a place from which of its places, and on the ways between them."""

from typing import NamedTuple

import numpy as np
from numba import njit


class Cover(NamedTuple):
    """What there is to plan over: n places, s samples of the area to see in words of 64 bits."""

    lengths: np.ndarray
    """Shape (n, n), float64, finite, symmetric: ways between places [m]."""
    before: np.ndarray
    """Shape (n, n), int32: `before[i, j]` is the last place before j on the way from i, or i itself."""
    near: np.ndarray
    """Shape (n, k), int32: the places nearest to each, itself left out."""
    sees: np.ndarray
    """Shape (n, words), uint64: a bit per sample that is seen from a place."""


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
def look(cover, first, last, seen):
    """Add to `seen` what is seen on the way from one place, itself left out, to another, itself included."""
    place = last
    while place != first:
        for w in range(seen.size):
            seen[w] |= cover.sees[place, w]
        place = cover.before[first, place]


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
        look(cover, tour[k], tour[k + 1], seen)
    return seen

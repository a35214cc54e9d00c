"""Short tours from which enough is seen: which viewpoints to go to, and in which order.

A tour begins at a start and may end anywhere. It need not pass all viewpoints: what counts is that what is seen from
its stops and from the viewpoints on the paths between them is enough. Improved by local search, and by replacing some
of the stops (Schrimpf et al., "Record Breaking Optimization Results Using the Ruin and Recreate Principle", 2000).
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from lidarnaut.baselines.frontier.open_tour import changed, is_shorter, tour_length

LEAST_SAVING = 1e-6
"""A change that saves less than this is none: it would be rounding."""
MAX_REMOVED = 8
"""Stops that are taken out of a tour at once."""
DEVIATION = 0.01
"""How much longer than the best tour one may be to go on from, as a share; goes down to 0 during the search."""
NOISE = 0.4
"""By how much noise raises the value of a viewpoint, as a share."""
SHORT_DETOUR = 0.2
"""Added to detours before gains are divided by them, so that one on the path is no better than any other [m]."""


class Cover(NamedTuple):
    """What there is to plan over: n viewpoints, s samples of the area to see in words of 64 bits."""

    lengths: np.ndarray
    """Shape (n, n), float64, finite, symmetric: path lengths between viewpoints [m]."""
    predecessors: np.ndarray
    """Shape (n, n), int32: `predecessors[i, j]` is the last viewpoint before j on the path from i, or i itself."""
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
def shorten(cover, known, target, tour):
    """Shorten a tour by 2-opt and or-opt, and leave out stops, where enough is still seen on the paths."""
    tour, has_changed = tour.copy(), True
    while has_changed:
        has_changed = False
        for i in range(1, tour.size - 1):
            for j in range(i + 1, tour.size):
                for k in range(i - 1, j):
                    if is_shorter(cover.lengths, tour, i, k, j, LEAST_SAVING):
                        other = changed(tour, i, k, j)
                        if count_bits(seen_on(cover, known, other)) >= target:
                            tour[:] = other
                            has_changed = True
    k = 1
    while k < tour.size:
        other = np.concatenate((tour[:k], tour[k + 1 :]))
        if count_bits(seen_on(cover, known, other)) >= target:
            tour = other
        else:
            k += 1
    return tour


@njit(cache=True, error_model="numpy")
def complete(cover, known, target, tour, noise, rng):
    """Insert stops into a tour until enough is seen: each time the one that shows most for its detour.

    Noise raises the values of viewpoints by up to a share. Returns what `search_tour` does, which says what is given.
    """
    while True:
        seen = seen_on(cover, known, tour)
        missing = target - count_bits(seen)
        if missing <= 0:
            return tour, True
        open_words = np.flatnonzero(seen != ~np.uint64(0))
        best, best_at, best_value = -1, 0, 0.0
        for viewpoint in range(len(cover.lengths)):
            gain = 0
            for w in open_words:
                gain += ones(cover.sees[viewpoint, w] & ~seen[w])
            if gain == 0:
                continue
            detour, at = cover.lengths[tour[-1], viewpoint], tour.size
            for k in range(tour.size - 1):
                more = cover.lengths[tour[k], viewpoint] + cover.lengths[viewpoint, tour[k + 1]]
                more -= cover.lengths[tour[k], tour[k + 1]]
                if more < detour:
                    detour, at = more, k + 1
            value = min(gain, missing) / (max(detour, 0.0) + SHORT_DETOUR) * (1.0 + noise * rng.random())
            if value > best_value:
                best, best_at, best_value = viewpoint, at, value
        if best < 0:
            return tour, False
        tour = np.concatenate((tour[:best_at], np.array([best]), tour[best_at:]))


@njit(cache=True, error_model="numpy")
def _ruin(cover, tour, rng):
    """Take out a random number of the stops that lie nearest to a random one; return the rest."""
    num_stops = tour.size - 1
    num_removed = 1 + int(rng.random() * min(MAX_REMOVED, num_stops))
    middle = tour[1 + int(rng.random() * num_stops)]
    kept = np.ones(tour.size, dtype=np.bool_)
    kept[1 + np.argsort(cover.lengths[middle][tour[1:]], kind="mergesort")[:num_removed]] = False
    return tour[kept]


@njit(cache=True, error_model="numpy")
def search_tour(cover, known, target, tour, num_rounds, rng):
    """Return a short tour on which `target` samples are known, or else all that can be; and whether they are enough.

    `known`: shape (words,), uint64, what is known without any tour; `tour`: shape (size,), int64, to begin with: the
    start first, and any stops; `num_rounds`: how often stops are taken out and others put in. The tour returned: shape
    (m,), int64.
    """
    tour, enough = complete(cover, known, target, tour, 0.0, rng)
    if not enough:
        target = count_bits(seen_on(cover, known, tour))
    best = present = shorten(cover, known, target, tour)
    best_length = tour_length(cover.lengths, best)
    for k in range(num_rounds):
        if present.size < 2:
            break
        other, other_enough = complete(cover, known, target, _ruin(cover, present, rng), NOISE, rng)
        if not other_enough:
            continue
        other = shorten(cover, known, target, other)
        length = tour_length(cover.lengths, other)
        if length < best_length - LEAST_SAVING:
            best, best_length = other, length
        if length <= best_length * (1.0 + DEVIATION * (1.0 - k / num_rounds)):
            present = other
    return best, enough

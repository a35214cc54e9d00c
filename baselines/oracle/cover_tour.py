"""Search for short tours of viewpoints that observe a given part of an area.

Local search with partial reconstruction (Schrimpf et al., "Record Breaking Optimization Results Using the Ruin and
Recreate Principle", 2000).
"""

from typing import NamedTuple

import numpy as np

from lidarnaut.baselines.frontier.open_tour import changed, is_shorter, tour_length
from lidarnaut.envs.compilation import njit

MIN_SAVING = 1e-6
MAX_REMOVED = 8
MAX_EXCESS_LENGTH = 0.01
VALUE_NOISE = 0.4
DETOUR_OFFSET = 0.2


class Cover(NamedTuple):
    """Input of the tour search: path lengths between start and viewpoints, and the cells visible from each viewpoint.

    Viewpoints come first, the start last. `lengths[i, j]`: path length [m] plus cost of a stop. `predecessors[i, j]`:
    last viewpoint before j on the path from i.
    """

    lengths: np.ndarray
    predecessors: np.ndarray
    sees: np.ndarray
    """Cells visible from each viewpoint, one bit per cell, shape (n, words), uint64."""


@njit(cache=True, error_model="numpy", inline="always")
def ones(word):
    """Return the number of set bits of a 64-bit word (Warren, Hacker's Delight, section 5-1)."""
    word = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
    word = (word & np.uint64(0x3333333333333333)) + ((word >> np.uint64(2)) & np.uint64(0x3333333333333333))
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return np.int64((word * np.uint64(0x0101010101010101)) >> np.uint64(56))


@njit(cache=True, error_model="numpy")
def count_bits(words):
    """Return the number of set bits of 64-bit words, shape (n,), uint64."""
    total = 0
    for word in words:
        total += ones(word)
    return total


@njit(cache=True, error_model="numpy")
def seen_on(cover, known, tour):
    """Return the cells observed before or during a tour, one bit per cell, shape (words,), uint64.

    `known`: cells observed before the tour. The view from its start does not count.
    """
    seen = known.copy()
    for k in range(tour.size - 1):
        viewpoint = tour[k + 1]
        while viewpoint != tour[k]:
            for w in range(seen.size):
                seen[w] |= cover.sees[viewpoint, w]
            viewpoint = cover.predecessors[tour[k], viewpoint]
    return seen


@njit(cache=True, error_model="numpy")
def shorten(cover, known, target, tour):
    """Shorten a tour by 2-opt, or-opt and removal of stops, such that at least `target` cells (a number) are observed.

    `known`: cells observed before the tour, one bit per cell.
    """
    tour, has_changed = tour.copy(), True
    while has_changed:
        has_changed = False
        for i in range(1, tour.size - 1):
            for j in range(i + 1, tour.size):
                for k in range(i - 1, j):
                    if is_shorter(cover.lengths, tour, i, k, j, MIN_SAVING):
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
    """Insert viewpoints into a tour until at least `target` cells (a number) are observed.

    Each step inserts the viewpoint with the highest ratio of newly observed cells to detour. `known`: cells observed
    before the tour, one bit per cell. `noise`: maximum random increase of this ratio, as a fraction. Returns the tour,
    and whether `target` is reached.
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
            value = min(gain, missing) / (max(detour, 0.0) + DETOUR_OFFSET) * (1.0 + noise * rng.random())
            if value > best_value:
                best, best_at, best_value = viewpoint, at, value
        if best < 0:
            return tour, False
        tour = np.concatenate((tour[:best_at], np.array([best]), tour[best_at:]))


@njit(cache=True, error_model="numpy")
def _ruin(cover, tour, rng):
    num_stops = tour.size - 1
    num_removed = 1 + int(rng.random() * min(MAX_REMOVED, num_stops))
    middle = tour[1 + int(rng.random() * num_stops)]
    kept = np.ones(tour.size, dtype=np.bool_)
    kept[1 + np.argsort(cover.lengths[middle][tour[1:]], kind="mergesort")[:num_removed]] = False
    return tour[kept]


@njit(cache=True, error_model="numpy")
def search_tour(cover, known, target, tour, num_rounds, rng):
    """Search for a short tour of viewpoints that observes at least `target` cells (a number), or as many as possible.

    `known`: cells observed before the tour, one bit per cell. `tour`: indices of the first tour, start first.
    `num_rounds`: number of attempts to improve the tour.

    Returns:
        Viewpoint indices of the tour, shape (m,), int64; whether `target` is reached.
    """
    tour, enough = complete(cover, known, target, tour, 0.0, rng)
    if not enough:
        target = count_bits(seen_on(cover, known, tour))
    best = present = shorten(cover, known, target, tour)
    best_length = tour_length(cover.lengths, best)
    for k in range(num_rounds):
        if present.size < 2:
            break
        other, other_enough = complete(cover, known, target, _ruin(cover, present, rng), VALUE_NOISE, rng)
        if not other_enough:
            continue
        other = shorten(cover, known, target, other)
        length = tour_length(cover.lengths, other)
        if length < best_length - MIN_SAVING:
            best, best_length = other, length
        if length <= best_length * (1.0 + MAX_EXCESS_LENGTH * (1.0 - k / num_rounds)):
            present = other
    return best, enough

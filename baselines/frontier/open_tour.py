"""Short open tours, from a start past every stop, and the changes by which those of the oracle are shortened too."""

import numpy as np
from numba import njit

IMPROVEMENT = 1e-9
"""A change that saves less than this is none: it would be rounding."""


@njit(cache=True, error_model="numpy")
def tour_length(lengths, tour):
    """Sum lengths, shape (n, n), float64, along a tour, shape (size,), int64: indices in order, the start first."""
    total = 0.0
    for k in range(len(tour) - 1):
        total += lengths[tour[k], tour[k + 1]]
    return total


@njit(cache=True, error_model="numpy")
def changed(tour, i, k, j):
    """Return a tour with its stretches i..k and k + 1..j swapped (or-opt, Or 1976); i..j reversed if k < i (2-opt)."""
    other = tour.copy()
    if k < i:
        other[i : j + 1] = tour[i : j + 1][::-1]
    else:
        other[i : i + j - k] = tour[k + 1 : j + 1]
        other[i + j - k : j + 1] = tour[i : k + 1]
    return other


@njit(cache=True, error_model="numpy", inline="always")
def is_shorter(lengths, tour, i, k, j, least):
    """Tell whether `changed(tour, i, k, j)` saves more than `least`; never where both stretches have over three stops.

    `lengths` are symmetric, and nothing follows the last stop.
    """
    if min(k - i, j - k - 1) > 2:
        return False
    before = lengths[tour[i - 1], tour[i]]
    if k < i:
        first, last, after = tour[j], tour[i], 0.0
    else:
        first, last, after = tour[k + 1], tour[k], lengths[tour[j], tour[i]]
        before += lengths[last, first]
    after += lengths[tour[i - 1], first]
    if j + 1 < len(tour):
        before += lengths[tour[j], tour[j + 1]]
        after += lengths[last, tour[j + 1]]
    return after < before - least


@njit(cache=True, error_model="numpy")
def _improve(lengths, tour, num_fixed):
    """Shorten a tour by 2-opt and or-opt until neither can; its first `num_fixed` indices stay where they are."""
    improved = True
    while improved:
        improved = False
        for swaps in (False, True):
            for i in range(num_fixed, len(tour) - 1):
                for j in range(i + 1, len(tour)):
                    for k in range(i if swaps else i - 1, j if swaps else i):
                        if is_shorter(lengths, tour, i, k, j, IMPROVEMENT):
                            tour[:] = changed(tour, i, k, j)
                            improved = True


@njit(cache=True, error_model="numpy")
def best_tours(lengths):
    """Find a short tour for each stop that could come first: to the nearest stop next, improved with 2-opt and or-opt.

    `lengths`: shape (n + 1, n + 1), float64, finite, symmetric, index 0 is the start. Returns the tours, shape (n, n +
    1), int64, the k-th with stop k + 1 after the start; and their lengths, shape (n,).
    """
    size = lengths.shape[0]
    tours = np.zeros((size - 1, size), dtype=np.int64)
    totals = np.empty(size - 1)
    for first in range(1, size):
        tour = tours[first - 1]
        left = np.ones(size, dtype=np.bool_)
        left[0] = left[first] = False
        tour[1] = first
        for k in range(2, size):
            tour[k] = np.argmin(np.where(left, lengths[tour[k - 1]], np.inf))
            left[tour[k]] = False
        _improve(lengths, tour, 2)
        totals[first - 1] = tour_length(lengths, tour)
    return tours, totals

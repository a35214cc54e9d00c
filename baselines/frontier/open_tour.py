"""Short open tours: from a start past every stop, ending anywhere."""

import numpy as np
from numba import njit

IMPROVEMENT = 1e-9
"""A change that saves less than this is none: it would be rounding."""


@njit(cache=True, error_model="numpy")
def tour_length(lengths, tour):
    """Sum the lengths along a tour.

    Args:
        lengths: shape (n + 1, n + 1), float64: between the start (index 0) and the stops.
        tour: shape (n + 1,), int64: indices in their order, the start first.
    """
    total = 0.0
    for k in range(len(tour) - 1):
        total += lengths[tour[k], tour[k + 1]]
    return total


@njit(cache=True, error_model="numpy")
def _step(lengths, tour, k, other):
    """Return the length from an index to the `k`-th stop; nothing follows the last one."""
    return lengths[other, tour[k]] if k < len(tour) else 0.0


@njit(cache=True, error_model="numpy")
def _reverse(tour, first, last):
    """Turn the stretch from `first` to `last` round."""
    while first < last:
        tour[first], tour[last] = tour[last], tour[first]
        first, last = first + 1, last - 1


@njit(cache=True, error_model="numpy")
def _improve(lengths, tour, num_fixed):
    """Reverse stretches (2-opt) and move up to three stops elsewhere (or-opt, Or 1976) until neither shortens the tour.

    Args:
        lengths: shape (n + 1, n + 1), float64, symmetric.
        tour: shape (n + 1,), int64, changed.
        num_fixed: indices at the tour's beginning that stay where they are.
    """
    size = len(tour)
    improved = True
    while improved:
        improved = False
        for i in range(num_fixed, size - 1):
            for j in range(i + 1, size):
                before = lengths[tour[i - 1], tour[i]] + _step(lengths, tour, j + 1, tour[j])
                after = lengths[tour[i - 1], tour[j]] + _step(lengths, tour, j + 1, tour[i])
                if after < before - IMPROVEMENT:
                    _reverse(tour, i, j)
                    improved = True
        # A stretch that is swapped with its neighbour has moved; 2-opt decides on its direction.
        for i in range(num_fixed, size - 1):
            for j in range(i + 1, size):
                for k in range(i, j):
                    if min(k - i, j - k - 1) > 2:
                        continue
                    # i..k and k + 1..j are swapped.
                    before = lengths[tour[i - 1], tour[i]] + lengths[tour[k], tour[k + 1]]
                    before += _step(lengths, tour, j + 1, tour[j])
                    after = lengths[tour[i - 1], tour[k + 1]] + lengths[tour[j], tour[i]]
                    after += _step(lengths, tour, j + 1, tour[k])
                    if after < before - IMPROVEMENT:
                        _reverse(tour, i, k)
                        _reverse(tour, k + 1, j)
                        _reverse(tour, i, j)
                        improved = True


@njit(cache=True, error_model="numpy")
def best_tours(lengths):
    """Find a short tour for each stop that could come first.

    Each begins with the nearest stop next, and is improved with 2-opt and or-opt.

    Args:
        lengths: shape (n + 1, n + 1), float64, finite, symmetric, index 0 is the start.

    Returns:
        Shape (n, n + 1), int64: tours, the k-th with stop k + 1 after the start; and their lengths, shape (n,).
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
            nearest, least = -1, np.inf
            for stop in range(1, size):
                if left[stop] and lengths[tour[k - 1], stop] < least:
                    nearest, least = stop, lengths[tour[k - 1], stop]
            tour[k] = nearest
            left[nearest] = False
        _improve(lengths, tour, 2)
        totals[first - 1] = tour_length(lengths, tour)
    return tours, totals

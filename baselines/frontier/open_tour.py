"""Short tours past all stops, without return to the start."""

import numpy as np

from lidarnaut.envs.compilation import njit

MIN_SAVING = 1e-9


@njit(cache=True, error_model="numpy")
def tour_length(lengths, tour):
    """Return the length of a tour [m].

    `lengths`: path lengths between points [m], shape (n, n), float64. `tour`: point indices in order, shape (size,),
    int64.
    """
    total = 0.0
    for k in range(len(tour) - 1):
        total += lengths[tour[k], tour[k + 1]]
    return total


@njit(cache=True, error_model="numpy")
def changed(tour, i, k, j):
    """Return a copy of a tour (point indices) with one change of local search, 2-opt or or-opt (Or 1976).

    2-opt, if k < i: points at positions i to j are reversed. Or-opt, otherwise: points at positions i to k change
    places with points at positions k + 1 to j.
    """
    other = tour.copy()
    if k < i:
        other[i : j + 1] = tour[i : j + 1][::-1]
    else:
        other[i : i + j - k] = tour[k + 1 : j + 1]
        other[i + j - k : j + 1] = tour[i : k + 1]
    return other


@njit(cache=True, error_model="numpy", inline="always")
def is_shorter(lengths, tour, i, k, j, least):
    """Return True if `changed(tour, i, k, j)` is shorter than `tour` by more than `least` [m].

    `lengths`: symmetric path lengths between points [m]. If both swapped sections have more than 3 points, the result
    is False.
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
    improved = True
    while improved:
        improved = False
        for swaps in (False, True):
            for i in range(num_fixed, len(tour) - 1):
                for j in range(i + 1, len(tour)):
                    for k in range(i if swaps else i - 1, j if swaps else i):
                        if is_shorter(lengths, tour, i, k, j, MIN_SAVING):
                            tour[:] = changed(tour, i, k, j)
                            improved = True


@njit(cache=True, error_model="numpy")
def best_tours(lengths):
    """Return a short tour for each possible first stop: nearest neighbor, then 2-opt and or-opt.

    Args:
        lengths: path lengths between the start (index 0) and n stops [m], shape (n + 1, n + 1), float64, finite,
            symmetric.

    Returns:
        Point indices of n tours, shape (n, n + 1), int64; tour k visits stop k + 1 first. Tour lengths [m], shape (n,).
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

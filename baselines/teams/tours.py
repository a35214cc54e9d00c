"""Open tours (without return) of several robots past all stops."""

import numpy as np

from lidarnaut.envs.compilation import njit

SUM_WEIGHT = 0.1
MAX_ROUNDS = 20


@njit(cache=True, error_model="numpy")
def _length(start, between, work, tour):
    total = 0.0
    for k in range((tour >= 0).sum()):
        total += work[tour[k]] + (between[tour[k - 1], tour[k]] if k > 0 else start[tour[0]])
    return total


@njit(cache=True, error_model="numpy")
def _insert(starts, between, work, tours, totals, stop):
    best, best_tour, best_total, best_robot = np.inf, tours[0], 0.0, 0
    for robot in range(len(tours)):
        tour = tours[robot].copy()
        size = (tour >= 0).sum()
        others = totals.sum() - totals[robot]
        longest = 0.0
        for k in range(len(totals)):
            longest = max(longest, totals[k] if k != robot else 0.0)
        for position in range(size, -1, -1):
            if position < size:
                tour[position + 1] = tour[position]
            tour[position] = stop
            total = _length(starts[robot], between, work, tour)
            value = max(longest, total) + SUM_WEIGHT * (others + total)
            if value < best:
                best, best_tour, best_total, best_robot = value, tour.copy(), total, robot
    tours[best_robot], totals[best_robot] = best_tour, best_total
    return best


@njit(cache=True, error_model="numpy")
def min_max_tours(starts, between, work):
    """Distribute m stops over n robots such that the longest tour is short.

    `starts`: path lengths from robots to stops [m], shape (n, m). `between`: path lengths between stops [m], shape (m,
    m), symmetric. `work`: additional cost of each stop [m], shape (m,). All are float64.

    Returns:
        Stop indices on the tour of each robot, in order, then -1: shape (n, m), int64.
    """
    num, count = starts.shape
    tours, totals = np.full((num, count), -1, dtype=np.int64), np.zeros(num)
    nearest = np.array([starts[:, stop].min() for stop in range(count)])
    value = 0.0
    for stop in np.argsort(-nearest):
        value = _insert(starts, between, work, tours, totals, stop)
    for _ in range(MAX_ROUNDS):
        before = value
        for stop in range(count):
            for robot in range(num):
                tour = tours[robot]
                if (tour == stop).any():
                    tour[:-1] = tour[tour != stop]
                    tour[-1] = -1
                    totals[robot] = _length(starts[robot], between, work, tour)
                    break
            value = _insert(starts, between, work, tours, totals, stop)
        if value >= before - 1e-9:
            break
    return tours

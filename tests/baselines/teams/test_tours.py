from itertools import pairwise, permutations, product

import numpy as np

from lidarnaut.baselines.teams.tours import SUM_WEIGHT, min_max_tours


def lengths_of(robots, stops):
    return (np.hypot(*(a[:, None] - stops).transpose(2, 0, 1)) for a in (robots, stops))


def totals_of(starts, between, work, tours):
    totals = []
    for row, tour in zip(starts, tours, strict=True):
        legs = sum(between[a, b] for a, b in pairwise(tour))
        totals.append(row[tour[0]] + legs + work[list(tour)].sum() if len(tour) else 0.0)
    return totals


def least(starts, between, work):
    num, count = starts.shape
    best = np.inf
    for owners in product(range(num), repeat=count):
        own = [[stop for stop in range(count) if owners[stop] == robot] for robot in range(num)]
        totals = [
            min(totals_of(row[None], between, work, [order])[0] for order in permutations(stops))
            for row, stops in zip(starts, own, strict=True)
        ]
        best = min(best, max(totals) + SUM_WEIGHT * sum(totals))
    return best


def test_tours_are_nearly_the_best_and_pass_every_stop_once():
    rng = np.random.default_rng(0)
    excess = []
    for _ in range(20):
        starts, between = lengths_of(rng.uniform(0.0, 4.0, (2, 2)), rng.uniform(0.0, 10.0, (5, 2)))
        work = rng.uniform(0.0, 3.0, 5)
        tours = [tour[tour >= 0].tolist() for tour in min_max_tours(starts, between, work)]
        assert sorted(stop for tour in tours for stop in tour) == list(range(5))
        totals = totals_of(starts, between, work, tours)
        excess.append((max(totals) + SUM_WEIGHT * sum(totals)) / least(starts, between, work))
    assert min(excess) > 1.0 - 1e-9
    assert np.median(excess) < 1.01
    assert max(excess) < 1.3


def test_work_at_a_stop_leaves_the_others_to_the_other_robot():
    starts, between = lengths_of(np.zeros((2, 2)), np.array([[1.0, 0.0], [2.0, 0.0], [3.0, 0.0]]))
    for work, expected in ((0.0, [[], [0, 1, 2]]), (50.0, [[0], [1, 2]])):
        tours = min_max_tours(starts, between, np.array([work, 0.0, 0.0]))
        assert sorted(tour[tour >= 0].tolist() for tour in tours) == expected

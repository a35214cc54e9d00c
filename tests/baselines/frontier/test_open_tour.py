"""Short tours against all permutations."""

from itertools import permutations

import numpy as np

from baselines.frontier.open_tour import best_tours, tour_length


def random_lengths(rng, num_stops):
    points = rng.uniform(0.0, 10.0, (num_stops + 1, 2))
    return np.hypot(*(points[:, None] - points).transpose(2, 0, 1))


def test_tours_are_almost_always_the_shortest_there_are():
    rng = np.random.default_rng(0)
    excess = []
    for _ in range(40):
        lengths = random_lengths(rng, 6)
        tours, totals = best_tours(lengths)
        for k in range(6):
            rest = [stop for stop in range(1, 7) if stop != k + 1]
            shortest = min(tour_length(lengths, np.array([0, k + 1, *order])) for order in permutations(rest))
            assert totals[k] >= shortest - 1e-9
            assert totals[k] == tour_length(lengths, tours[k])
            excess.append(totals[k] / shortest - 1.0)
    assert np.mean(np.array(excess) < 1e-9) > 0.9
    assert np.max(excess) < 0.15


def test_tours_pass_every_stop_once_and_begin_with_the_fixed_ones():
    tours, _ = best_tours(random_lengths(np.random.default_rng(1), 16))
    for k, tour in enumerate(tours):
        assert list(tour[:2]) == [0, k + 1]
        assert sorted(tour) == list(range(17))

from itertools import pairwise, permutations

import numpy as np
import pytest

from lidarnaut.baselines.frontier.open_tour import tour_length
from lidarnaut.baselines.oracle.cover_tour import Cover, complete, count_bits, search_tour, seen_on, shorten

NOTHING, START = np.zeros(1, dtype=np.uint64), np.array([0])


def cover_of(points, sees):
    """Viewpoints joined by straight lines, with a small cost per stop; no viewpoint is on a path."""
    points = np.asarray(points, dtype=float)
    n = len(points)
    lengths = np.hypot(*(points[:, None] - points).transpose(2, 0, 1)) + 1e-3
    before = np.repeat(np.arange(n, dtype=np.int32)[:, None], n, axis=1)
    return Cover(lengths, before, np.asarray(sees, dtype=np.uint64).reshape(n, 1))


def shortest(cover, target):
    """Try all orders of all subsets; viewpoint 0 is the start."""
    best = np.inf
    for size in range(len(cover.lengths)):
        for stops in permutations(range(1, len(cover.lengths)), size):
            seen = np.bitwise_or.reduce(cover.sees[list(stops), 0], initial=0)
            if int(seen).bit_count() >= target:
                best = min(best, sum(cover.lengths[a, b] for a, b in pairwise((0, *stops))))
    return best


def random_cover(rng, num_viewpoints):
    sees = [0] + [int(rng.integers(1, 1 << 12)) & int(rng.integers(1, 1 << 12)) for _ in range(num_viewpoints)]
    return cover_of(rng.uniform(0.0, 10.0, (num_viewpoints + 1, 2)), sees)


@pytest.mark.parametrize("share", [1.0, 0.7])
def test_tours_are_almost_always_the_shortest_from_which_enough_is_seen(share):
    rng = np.random.default_rng(0)
    excess = []
    for _ in range(20):
        cover = random_cover(rng, 6)
        target = int(share * count_bits(np.bitwise_or.reduce(cover.sees)))
        tour, enough = search_tour(cover, NOTHING, target, START, 60, rng)
        assert enough
        assert tour[0] == 0
        assert len(set(tour)) == len(tour)
        assert count_bits(seen_on(cover, NOTHING, tour)) >= target
        excess.append(tour_length(cover.lengths, tour) / shortest(cover, target) - 1.0)
    assert np.min(excess) > -1e-9
    assert np.mean(np.array(excess) < 1e-9) >= 0.9
    assert np.max(excess) < 0.05


def test_seven_stops_that_all_must_be_passed_are_passed_in_the_best_order():
    rng = np.random.default_rng(1)
    cover = cover_of(rng.uniform(0.0, 10.0, (8, 2)), [0] + [1 << k for k in range(7)])
    tour, _ = search_tour(cover, NOTHING, 7, START, 60, rng)
    lengths = [tour_length(cover.lengths, np.array([0, *order])) for order in permutations(range(1, 8))]
    assert sorted(tour) == list(range(8))
    assert tour_length(cover.lengths, tour) == pytest.approx(min(lengths))


@pytest.mark.parametrize(
    ("known", "target", "expected"),
    [(0, 3, [0, 3]), (0, 2, [0, 2]), (6, 3, [0, 1])],
    ids=["all is seen on the path", "what is beyond the share is left", "what is known needs no path"],
)
def test_what_is_seen_on_a_path_needs_no_stop(known, target, expected):
    cover = cover_of([(0, 0), (1, 0), (2, 0), (3, 0)], [0, 1, 2, 4])
    cover.predecessors[0, 3], cover.predecessors[0, 2] = 2, 1
    known = np.array([known], dtype=np.uint64)
    tour, enough = search_tour(cover, known, target, START, 20, np.random.default_rng(0))
    assert enough
    assert tour.tolist() == expected


def test_all_that_can_be_seen_is_when_it_is_not_enough():
    cover = cover_of([(0, 0), (1, 0), (-2, 0)], [0, 1, 2])
    tour, enough = search_tour(cover, NOTHING, 5, START, 20, np.random.default_rng(0))
    assert not enough
    assert tour.tolist() == [0, 1, 2]
    assert not complete(cover, NOTHING, 5, START, 0.0, np.random.default_rng(0))[1]


def test_stops_are_reordered_and_left_out_where_enough_is_still_seen():
    cover = cover_of([(0, 0), (4, 0), (1, 0), (3, 0), (2, 0)], [0, 1, 2, 4, 6])
    assert shorten(cover, NOTHING, 3, np.array([0, 1, 2, 3])).tolist() == [0, 2, 3, 1]
    assert shorten(cover, NOTHING, 3, np.array([0, 2, 4, 1])).tolist() == [0, 4, 1]

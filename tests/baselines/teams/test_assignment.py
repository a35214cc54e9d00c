from itertools import pairwise, permutations, product

import numpy as np
import pytest

from lidarnaut.baselines import TEAMS, Auction, MinMaxTours, TeamExplorer
from lidarnaut.baselines.episode import run_episode
from lidarnaut.baselines.frontier.rules import nearest
from lidarnaut.baselines.frontier.tour import cover
from lidarnaut.baselines.teams.assignment import COVER_RADIUS, MAX_STOPS, SUM_WEIGHT, min_max_tours
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.navigation import GainOverCost
from lidarnaut.envs.navigation.teams.team_navigator import UNASSIGNED, discount
from lidarnaut.envs.tasks.explore import ExploreTeam
from tests.baselines.maps import belief_at, candidates_from, corridor

NONE = np.empty((0, 2))


def offers_at(*positions, grid=None):
    return [candidates_from(x, y, grid) for x, y in positions], [belief_at(x, y, grid) for x, y in positions]


def frontiers(offers, chosen):
    return [tuple(candidates["frontier"][k]) for candidates, k in zip(offers, chosen, strict=True)]


def test_a_robot_alone_buys_what_the_rule_rates_highest():
    (candidates,), beliefs = offers_at((4.0, 0.0))
    for rule in (GainOverCost(), nearest):
        assert Auction(rule)([candidates], NONE, beliefs) == [rule(candidates, beliefs[0]).argmax()]


def test_robots_side_by_side_go_to_different_openings():
    offers, beliefs = offers_at((4.0, 0.3), (4.0, -0.3))
    alone = [Auction()([one], NONE, [belief])[0] for one, belief in zip(offers, beliefs, strict=True)]
    (x, _), (other, _) = frontiers(offers, alone)
    assert abs(x - other) < 1.0
    before = [one.table.copy() for one in offers]
    (x, _), (other, _) = frontiers(offers, Auction()(offers, NONE, beliefs))
    assert abs(x - other) > 5.0
    assert all((one.table == table).all() for one, table in zip(offers, before, strict=True))


def test_the_highest_bid_wins_and_what_others_drive_to_is_no_gain(monkeypatch):
    monkeypatch.setattr("lidarnaut.envs.navigation.teams.team_navigator.OVERLAP", 6.0)
    offers, beliefs = offers_at((3.0, 0.0), (8.0, 0.0))
    far, near = frontiers(offers, Auction()(offers, NONE, beliefs))
    assert near[0] > 8.0 > far[0]
    (goal,) = frontiers(offers[1:], Auction()(offers[1:], np.array([near]), beliefs[1:]))
    assert goal[0] < 8.0


def test_gain_near_the_frontier_of_another_robot_counts_in_proportion_to_the_distance():
    candidates = candidates_from(4.0, 0.0)
    visible, frontier = candidates["visible"].copy(), candidates["frontier"][0].copy()
    discount(candidates, frontier)
    shares = np.minimum(np.hypot(*(candidates["frontier"] - frontier).T) / 2.0, 1.0)
    np.testing.assert_allclose(candidates["visible"], shares * visible)
    assert candidates["visible"][0] == 0.0


@pytest.mark.parametrize("rule", [Auction(), MinMaxTours()])
def test_robots_without_candidates_get_none_and_all_others_get_one(rule):
    closed = offers_at((5.0, 0.0), grid=corridor())
    pockets = offers_at((5.0, 0.0), (6.0, 0.0), (15.0, 0.0), grid=corridor((40, 60), (340, 360)))
    assert rule(*(closed[0], NONE, closed[1])) == [UNASSIGNED]
    chosen = rule([*pockets[0], *closed[0]], NONE, [*pockets[1], *closed[1]])
    assert chosen[3] == UNASSIGNED
    assert UNASSIGNED not in chosen[:3]
    goals = [x for x, _ in frontiers(pockets[0], chosen[:3])]
    assert min(goals) < 5.0
    assert goals[2] > 15.0


def test_tours_share_out_pockets_so_that_neither_robot_drives_to_and_fro():
    grid = corridor((30, 40), (90, 100), (290, 300), (350, 360))
    offers, beliefs = offers_at((9.6, -0.4), (10.4, -0.4), grid=grid)
    (left, _), (right, _) = frontiers(offers, MinMaxTours()(offers, NONE, beliefs))
    assert left < 7.0 < 13.0 < right


def test_stops_cover_all_frontiers_and_what_failed_waits():
    candidates = candidates_from(10.0, 0.0, corridor((30, 40), (60, 70), (340, 360)))
    table = candidates.table.copy()
    stops, stop_of = cover(table, COVER_RADIUS, MAX_STOPS)
    assert len(stops) == 2 or len(stops) == 3
    gaps = np.hypot(*(table["frontier"] - table["frontier"][stops][stop_of]).T)
    assert (stop_of >= 0).all()
    assert gaps.max() <= 2.0
    table["failures"][stops[0]] = 1
    others, left = cover(table, COVER_RADIUS, MAX_STOPS)
    assert stops[0] not in others
    assert left[stops[0]] == -1


@pytest.mark.parametrize("name", ["auction", "mtsp"])
def test_a_team_explores_a_small_world_without_touching(name):
    env = LidarEnv(ExploreTeam, world="rooms", world_size=(8.0, 8.0), physics="kinematic", target_coverage=0.95)
    episode = run_episode(env, TEAMS["coverage"][name](), 1)
    assert (episode.end_reason, episode.collisions) == ("covered", 0.0)


def test_a_team_ends_where_no_frontier_is_left_and_must_be_reset_first():
    env = LidarEnv(ExploreTeam, world="pimouse_arena", physics="kinematic", slam="truth", target_coverage=1.0)
    team = TeamExplorer(Auction())
    with pytest.raises(RuntimeError, match="reset"):
        team.act([], [])
    assert (team.plans, team.end_reason) == ([], None)
    episode = run_episode(env, team, 0)
    assert episode.end_reason in ("covered", "no_reachable_frontier")
    assert episode.duration < 100.0


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

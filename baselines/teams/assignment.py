"""Assignment of frontiers to robots."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Protocol

import numpy as np

from lidarnaut.baselines.frontier.rule_explorer import FrontierRule
from lidarnaut.baselines.frontier.tour import UNREACHABLE_LENGTH, cover, path_lengths
from lidarnaut.envs.compilation import njit
from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.navigation import Candidates, GainOverCost
from lidarnaut.envs.navigation.teams.team_navigator import UNASSIGNED, discount

COVER_RADIUS = 2.0
"""Frontiers within this distance of a tour stop need no stop of their own [m]."""
MAX_STOPS = 32
WORK_PER_AREA = 0.3
"""Cost of exploring the unknown area visible from a tour stop, expressed as path length [m/m2]."""
STOP_HYSTERESIS = 6.0
"""Length subtracted from the path to a robot's current stop, against oscillation between stops [m]."""
SUM_WEIGHT = 0.1
"""The cost of an assignment is the length of the longest tour plus this weight times the sum of all tours."""
MAX_ROUNDS = 20


class Assignment(Protocol):
    """Function that assigns candidates (reachable frontiers) to robots."""

    def __call__(self, offers: Sequence[Candidates], taken: np.ndarray, beliefs: Sequence[Belief]) -> Sequence[int]:
        """Return the index of each robot's candidate (reachable frontier), -1 for none.

        `offers`: candidates of each robot. `taken`: frontiers that other robots drive to, shape (k, 2), map
        frame [m]. `beliefs`: estimated pose and map of each robot.
        """


class Auction:
    """Sequential single-item auction of frontiers among robots, with frontier scores as bids.

    Zlot, Stentz, Dias, Thayer, "Multi-robot exploration controlled by a market economy" (2002); Koenig et al., "The
    power of sequential single-item auctions for agent coordination" (2006). Each sale lowers the gain of nearby
    frontiers.
    """

    def __init__(self, rule: FrontierRule | None = None) -> None:
        self._rule = rule or GainOverCost()

    def __call__(self, offers: Sequence[Candidates], taken: np.ndarray, beliefs: Sequence[Belief]) -> list[int]:
        offers = [replace(candidates, table=candidates.table.copy()) for candidates in offers]
        chosen = [UNASSIGNED] * len(offers)
        left = [k for k, candidates in enumerate(offers) if len(candidates)]
        for candidates, frontier in product(offers, taken):
            discount(candidates, frontier)
        while left:
            bids = {k: np.asarray(self._rule(offers[k], beliefs[k])) for k in left}
            winner = max(left, key=lambda k: float(bids[k].max()))
            chosen[winner] = int(bids[winner].argmax())
            left.remove(winner)
            for candidates in offers:
                discount(candidates, offers[winner]["frontier"][chosen[winner]])
        return chosen


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


class MinMaxTours:
    """Assigns each robot the first stop of a tour; the tours visit all frontiers, and the longest is kept short.

    Min-max multiple travelling salesman problem: Faigl, Kulich, Preucil, "Goal assignment using distance cost in
    multi-robot exploration" (2012).
    """

    def __init__(self) -> None:
        self._auction = Auction()

    def __call__(self, offers: Sequence[Candidates], taken: np.ndarray, beliefs: Sequence[Belief]) -> list[int]:
        table = np.concatenate([candidates.table for candidates in offers])
        if len(table) == 0:
            return [UNASSIGNED] * len(offers)
        owners = np.repeat(np.arange(len(offers)), [len(candidates) for candidates in offers])
        firsts = np.searchsorted(owners, np.arange(len(offers)))
        stops, stop_of = cover(table, COVER_RADIUS, MAX_STOPS)
        is_known = stop_of >= 0
        lengths, work = np.full((len(offers), len(stops)), UNREACHABLE_LENGTH), np.zeros(len(stops))
        np.minimum.at(lengths, (owners[is_known], stop_of[is_known]), table["cost"][is_known])
        np.maximum.at(work, stop_of[is_known], WORK_PER_AREA * table["visible"][is_known])
        for k, candidates in enumerate(offers):
            current = stop_of[firsts[k] + candidates.chosen] if candidates.chosen >= 0 else -1
            if current >= 0:
                lengths[k, current] -= STOP_HYSTERESIS
        points = table["viewpoint"][stops]
        between = path_lengths(max(offers, key=len).costmap, tuple(points[0].tolist()), points[1:])
        tours = min_max_tours(lengths, between, work)
        chosen = [UNASSIGNED] * len(offers)
        for k, candidates in enumerate(offers):
            own = np.flatnonzero(stop_of[firsts[k] : firsts[k] + len(candidates)] == tours[k, 0])
            if tours[k, 0] >= 0 and len(own):
                chosen[k] = int(own[0])
        left = [k for k, index in enumerate(chosen) if index == UNASSIGNED]
        goals = [offers[k]["frontier"][index] for k, index in enumerate(chosen) if index != UNASSIGNED]
        rest = self._auction([offers[k] for k in left], np.vstack([taken, *goals]), [beliefs[k] for k in left])
        for k, index in zip(left, rest, strict=True):
            chosen[k] = index
        return chosen

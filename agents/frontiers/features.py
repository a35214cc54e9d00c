"""Features of frontier candidates for a linear score, from observations of `ExploreFrontiers-v0`."""

import math

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry.lookup import record_type
from lidarnaut.envs.navigation import GainOverCost
from lidarnaut.envs.navigation.frontiers import candidates as column
from lidarnaut.envs.navigation.frontiers.views import NUM_SECTORS

_NAMES = """
log_visible minus_log_cost log_visible_3 minus_log_cost_half minus_cost cost_ratio unknown_1m unknown_2m unknown_4m
minus_turn log_size clearance age chosen failures minus_rank log_gap_first log_gap_second log_visible_around
log_number_around free_range free_range_outward unknown_outward unknown_sectors number_x_log_cost
number_x_log_visible range_x_log_visible range_x_log_cost small_and_near very_near share_of_visible
left_x_log_visible left_x_log_cost log_mean_gap detour ahead
"""
NAMES = tuple(_NAMES.split())
NUM_FEATURES = len(NAMES)
SCORE_FEATURES = record_type([(name, np.float64) for name in NAMES])
"""Structured dtype of the score features of a candidate."""
LEAST_GAIN, LEAST_COST = GainOverCost().least_gain, GainOverCost().least_cost
"""Constants that the rule `gain_over_cost` adds to visible unknown area [m2] and to path cost [m]."""
PRIOR = np.array([float(name in ("log_visible", "minus_log_cost")) for name in NAMES])
"""Score weights that reproduce the rule `gain_over_cost` (unknown area / path cost), shape (NUM_FEATURES,), float64."""
NEAREST = np.array([float(name == "minus_log_cost") for name in NAMES])
"""Score weights that select the nearest frontier, shape (NUM_FEATURES,), float64."""


@njit(cache=True, error_model="numpy")
def _length(share, half):
    return half * share / max(1.0 - share, 1e-6)


def score_features(
    candidates: np.ndarray, sectors: np.ndarray, gaps: np.ndarray, robot: np.ndarray, count: int
) -> np.ndarray:
    """Return score features of the first `count` frontier candidates, shape (count, NUM_FEATURES), float64.

    Other arguments: entries of the observation of `ExploreFrontiers-v0`.
    """
    rows = _score_features(candidates, sectors, gaps, robot, count)
    return rows.view(np.float64).reshape(count, NUM_FEATURES)


@njit(cache=True, error_model="numpy")
def _neighbours(gaps, visible, i, count):
    first = second = 20.0
    around, near, mean = visible[i], 0.0, 0.0
    for j in range(count):
        if j != i:
            gap = _length(gaps[i, j], column.HALF_COST)
            mean += gap
            around += visible[j] * math.exp(-gap / 3.0)
            near += math.exp(-gap / 2.0)
            if gap < first:
                first, second = gap, first
            elif gap < second:
                second = gap
    return first, second, around, near, mean / (count - 1) if count > 1 else 0.0


@njit(cache=True, error_model="numpy")
def _score_features(candidates, sectors, gaps, robot, count):
    rows = np.empty(count, dtype=SCORE_FEATURES)
    visible, cost = np.empty(count), np.empty(count)
    for i in range(count):
        visible[i] = _length(candidates[i, column.VISIBLE], column.HALF_AREA)
        cost[i] = _length(candidates[i, column.COST], column.HALF_COST)
    total = visible.sum()
    number, left, reach = count / 16.0, total / (total + 50.0), robot[0]
    for i in range(count):
        row, out = candidates[i], rows[i]
        first, second, around, near, mean = _neighbours(gaps, visible, i, count)
        size, age = _length(row[column.SIZE], column.HALF_SIZE), _length(row[column.AGE], column.HALF_AGE)
        distance = column.OFFSET_SCALE * math.hypot(row[column.AHEAD], row[column.LEFT])
        log_visible, minus_log_cost = math.log(visible[i] + LEAST_GAIN), -math.log(cost[i] + LEAST_COST)
        free, unknown = sectors[i, :NUM_SECTORS], sectors[i, NUM_SECTORS:]
        wide = 0.0
        for k in range(NUM_SECTORS):
            wide += unknown[k] > 0.3
        out.log_visible = log_visible
        out.minus_log_cost = minus_log_cost
        out.log_visible_3 = math.log(visible[i] + 3.0)
        out.minus_log_cost_half = -math.log(cost[i] + 0.5)
        out.minus_cost = -0.1 * cost[i]
        out.cost_ratio = row[column.COST_RATIO]
        out.unknown_1m = row[column.UNKNOWN_1M]
        out.unknown_2m = row[column.UNKNOWN_2M]
        out.unknown_4m = row[column.UNKNOWN_4M]
        out.minus_turn = -abs(row[column.TURN])
        out.log_size = math.log(size + 0.2)
        out.clearance = row[column.CLEARANCE]
        out.age = age / (age + 60.0)
        out.chosen = row[column.CHOSEN]
        out.failures = row[column.FAILURES]
        out.minus_rank = -3.0 * row[column.RANK]
        out.log_gap_first = math.log(first + 0.5)
        out.log_gap_second = math.log(second + 0.5)
        out.log_visible_around = math.log(around + 0.3)
        out.log_number_around = math.log(1.0 + near)
        out.free_range = free.mean()
        out.free_range_outward = (free[0] + free[1] + free[2] + free[-1] + free[-2]) / 5.0
        out.unknown_outward = (unknown[0] + unknown[1] + unknown[2] + unknown[-1] + unknown[-2]) / 5.0
        out.unknown_sectors = wide / NUM_SECTORS
        out.number_x_log_cost = number * minus_log_cost
        out.number_x_log_visible = number * log_visible
        out.range_x_log_visible = reach * log_visible
        out.range_x_log_cost = reach * minus_log_cost
        out.small_and_near = math.exp(-cost[i] / 3.0 - visible[i] / 2.0)
        out.very_near = math.exp(-cost[i] / 1.5)
        out.share_of_visible = visible[i] / (total + 0.3)
        out.left_x_log_visible = left * log_visible
        out.left_x_log_cost = left * minus_log_cost
        out.log_mean_gap = math.log(mean + 1.0)
        out.detour = min((distance + 0.5) / (cost[i] + 0.5), 2.0)
        out.ahead = row[column.AHEAD] * column.OFFSET_SCALE / (distance + 0.5)
    return rows

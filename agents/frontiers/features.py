"""Features of frontier candidates for a linear score, from observations of `ExploreFrontiers-v0`."""

import math

import numpy as np
from numba import njit

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
LEAST_GAIN, LEAST_COST = GainOverCost().least_gain, GainOverCost().least_cost
"""Constants that the rule `gain_over_cost` adds to visible unknown area [m2] and to path cost [m]."""
PRIOR = np.array([float(name in ("log_visible", "minus_log_cost")) for name in NAMES])
"""Score weights that reproduce the rule `gain_over_cost` (unknown area / path cost), shape (NUM_FEATURES,), float64."""
NEAREST = np.array([float(name == "minus_log_cost") for name in NAMES])
"""Score weights that select the nearest frontier, shape (NUM_FEATURES,), float64."""


@njit(cache=True, error_model="numpy")
def _length(share, half):
    return half * share / max(1.0 - share, 1e-6)


@njit(cache=True, error_model="numpy")
def score_features(candidates, sectors, gaps, robot, count):
    """Return score features of the first `count` frontier candidates, shape (count, NUM_FEATURES), float64.

    Other arguments: entries of the observation of `ExploreFrontiers-v0`.
    """
    out = np.empty((count, NUM_FEATURES))
    visible, cost = np.empty(count), np.empty(count)
    for i in range(count):
        visible[i] = _length(candidates[i, column.VISIBLE], column.HALF_AREA)
        cost[i] = _length(candidates[i, column.COST], column.HALF_COST)
    total = visible.sum()
    number, left, reach = count / 16.0, total / (total + 50.0), robot[0]
    for i in range(count):
        row, f = candidates[i], out[i]
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
        mean = mean / (count - 1) if count > 1 else 0.0
        size, age = _length(row[column.SIZE], column.HALF_SIZE), _length(row[column.AGE], column.HALF_AGE)
        distance = column.OFFSET_SCALE * math.hypot(row[column.AHEAD], row[column.LEFT])
        log_visible, minus_log_cost = math.log(visible[i] + LEAST_GAIN), -math.log(cost[i] + LEAST_COST)
        free, unknown = sectors[i, :NUM_SECTORS], sectors[i, NUM_SECTORS:]
        wide = 0.0
        for k in range(NUM_SECTORS):
            wide += unknown[k] > 0.3
        f[0], f[1] = log_visible, minus_log_cost
        f[2], f[3] = math.log(visible[i] + 3.0), -math.log(cost[i] + 0.5)
        f[4], f[5] = -0.1 * cost[i], row[column.COST_RATIO]
        f[6], f[7], f[8] = row[column.UNKNOWN_1M], row[column.UNKNOWN_2M], row[column.UNKNOWN_4M]
        f[9], f[10], f[11] = -abs(row[column.TURN]), math.log(size + 0.2), row[column.CLEARANCE]
        f[12], f[13], f[14] = age / (age + 60.0), row[column.CHOSEN], row[column.FAILURES]
        f[15] = -3.0 * row[column.RANK]
        f[16], f[17] = math.log(first + 0.5), math.log(second + 0.5)
        f[18], f[19] = math.log(around + 0.3), math.log(1.0 + near)
        f[20] = free.mean()
        f[21] = (free[0] + free[1] + free[2] + free[NUM_SECTORS - 1] + free[NUM_SECTORS - 2]) / 5.0
        f[22] = (unknown[0] + unknown[1] + unknown[2] + unknown[NUM_SECTORS - 1] + unknown[NUM_SECTORS - 2]) / 5.0
        f[23] = wide / NUM_SECTORS
        f[24], f[25] = number * minus_log_cost, number * log_visible
        f[26], f[27] = reach * log_visible, reach * minus_log_cost
        f[28], f[29] = math.exp(-cost[i] / 3.0 - visible[i] / 2.0), math.exp(-cost[i] / 1.5)
        f[30] = visible[i] / (total + 0.3)
        f[31], f[32] = left * log_visible, left * minus_log_cost
        f[33] = math.log(mean + 1.0)
        f[34] = min((distance + 0.5) / (cost[i] + 0.5), 2.0)
        f[35] = row[column.AHEAD] * column.OFFSET_SCALE / (distance + 0.5)
    return out

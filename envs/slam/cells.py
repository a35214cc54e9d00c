"""The state of a cell of TinySLAM's map, and how one observation changes it.

A cell is one 32-bit word: a signed fixed-point occupancy in the upper 20 bits (18 of them fractional) and the number of
observations in the lower 12. One load tells the matcher the occupancy, one load and one store update it, and sums of
occupancies are exact integers whatever the order of adding.
"""

import numpy as np
from numba import njit

COUNT_BITS = 12
"""Bits of a word that count observations."""
MAX_COUNT = (1 << COUNT_BITS) - 1
"""Count at which a cell stops counting; from there on each observation weighs 1 / (MAX_COUNT + 1)."""
ONE = 1 << 18
"""Occupancy 1 as fixed-point number."""
GAIN_ONE = 1 << 24
"""Gain 1 as fixed-point number."""
AVERAGE = -1
"""In place of a gain: weigh the observation such that the cell holds the mean of all of them."""

RECIPROCALS = np.round(GAIN_ONE / np.arange(1, MAX_COUNT + 2)).astype(np.int64)
"""Gain of the observation that follows n others in a mean, shape (MAX_COUNT + 1,), fixed-point."""


def unvisited_word(value: float) -> int:
    """Return the word of a cell never observed, which the matcher shall take for `value` (in [-1, 1])."""
    return round(value * ONE) << COUNT_BITS


def probabilities(words: np.ndarray) -> np.ndarray:
    """Return the occupancy that words stand for, same shape, float64."""
    return (words >> COUNT_BITS) / ONE


@njit(cache=True, error_model="numpy")
def integrate(word, target, gain):
    """Return the word of a cell after one more observation: value += (target - value) * gain.

    Target and gain are fixed-point, the gain may be AVERAGE. A cell never observed starts from one half.
    """
    count = word & MAX_COUNT
    value = word >> COUNT_BITS
    if gain == AVERAGE:
        gain = RECIPROCALS[np.uint64(count)]
    elif count == 0:
        value = ONE // 2
    value += ((target - value) * gain + GAIN_ONE // 2) >> 24
    return (value << COUNT_BITS) | min(count + 1, MAX_COUNT)


@njit(cache=True, error_model="numpy")
def percent(word):
    """Return the occupancy of a word in percent, as ROS grids hold it."""
    return ((word >> COUNT_BITS) * 100 + ONE // 2) >> 18

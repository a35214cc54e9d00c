"""Drawing particles by weight, as many as the spread of the cloud needs."""

import math

import numpy as np
from numba import njit

GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
"""Step of the draws around the circle of cumulated weights [turns]."""


@njit(cache=True, error_model="numpy")
def particles_needed(num_bins, error, quantile):
    """Return how many particles describe a distribution over `num_bins` bins (Fox 2003, equation 7); 0 for one bin.

    Args:
        num_bins: bins that hold a particle.
        error: how far the particles' distribution may be from the true one (Kullback-Leibler).
        quantile: upper quantile of the standard normal with which that holds.
    """
    if num_bins < 2:
        return 0.0
    k = num_bins - 1.0
    a = 2.0 / (9.0 * k)
    return k / (2.0 * error) * (1.0 - a + math.sqrt(a) * quantile) ** 3


@njit(cache=True, error_model="numpy")
def cumulate(weights, cumulated, guide):
    """Prepare for draws: sum weights up, and tabulate where to look for each n-th part of the sum.

    Args:
        weights: shape (n,), float64, with the sum 1.
        cumulated: shape (n,), float64, written.
        guide: shape (n,), int32, written: the first particle that a draw of at least k / n can hit.
    """
    n = weights.shape[0]
    total = 0.0
    slot = 0
    for i in range(n):
        total += weights[i]
        cumulated[i] = total
        while slot < n and slot < total * n:
            guide[slot] = i
            slot += 1
    cumulated[n - 1] = np.inf
    guide[slot:] = n - 1


@njit(cache=True, error_model="numpy")
def draw(particles, weights, bins, fresh, share, start, least, error, quantile, slot_of_bin, bin_of_slot, drawn):
    """Draw particles by weight until there are as many as the bins that they fall into need.

    Low-variance sampling takes every n-th part of the sum of weights, for which n must be known, and goes through them
    in order, so that one cannot stop early. Steps of the golden ratio spread about as evenly, however many there are.

    Args:
        particles: shape (3, n), float32 [m, rad].
        weights: shape (n,), float64, with the sum 1.
        bins: shape (n,), int32, the particles' bins.
        fresh: shape (3, f), float32, particles to mix in, f >= `share` * m + 1.
        share: share of the fresh ones among the drawn, 0 to 1.
        start: where to begin, 0 to 1.
        least: least number of particles.
        error: see `particles_needed`.
        quantile: see `particles_needed`.
        slot_of_bin: shape (num_bins,), int32, scratch; may hold anything from 0 on.
        bin_of_slot: shape (>= m,), int32, scratch.
        drawn: shape (3, m), float32, written.

    Returns:
        How many were drawn, at most m; the bins of fresh ones are taken to be their own.
    """
    n = particles.shape[1]
    cumulated, guide = np.empty(n), np.empty(n, dtype=np.int32)
    cumulate(weights, cumulated, guide)
    needed = float(least)
    is_adaptive = least < drawn.shape[1]
    num_bins = 0
    num_fresh = 0
    for k in range(drawn.shape[1]):
        if k >= needed:
            return k
        if share > 0.0 and math.floor((k + 1) * share + start) > math.floor(k * share + start):
            drawn[:, k] = fresh[:, num_fresh]
            num_fresh += 1
            bin_of_slot[num_bins] = -1
            is_new = True
        else:
            u = start + k * GOLDEN
            u -= math.floor(u)
            i = guide[int(u * n)]
            while cumulated[i] <= u:
                i += 1
            drawn[0, k], drawn[1, k], drawn[2, k] = particles[0, i], particles[1, i], particles[2, i]
            if not is_adaptive:
                continue
            slot = slot_of_bin[bins[i]]
            is_new = slot >= num_bins or bin_of_slot[slot] != bins[i]
            if is_new:
                slot_of_bin[bins[i]] = num_bins
                bin_of_slot[num_bins] = bins[i]
        if is_new:
            num_bins += 1
            needed = max(float(least), particles_needed(num_bins, error, quantile))
    return drawn.shape[1]

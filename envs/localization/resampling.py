"""KLD-sampling: resampling with an adaptive number of particles."""

import math

import numpy as np
from numba import njit

GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
"""Step of the golden-ratio sequence, which replaces random numbers in resampling."""


@njit(cache=True, error_model="numpy")
def particles_needed(num_bins, error, quantile):
    """Return the number of particles that KLD-sampling needs for `num_bins` occupied bins (Fox 2003, equation 7).

    `error`: maximum Kullback-Leibler divergence. `quantile`: standard normal quantile of the probability of this bound.
    """
    if num_bins < 2:
        return 0.0
    k = num_bins - 1.0
    a = 2.0 / (9.0 * k)
    return k / (2.0 * error) * (1.0 - a + math.sqrt(a) * quantile) ** 3


@njit(cache=True, error_model="numpy")
def cumulate(weights, cumulated, guide):
    """Compute cumulative particle weights, shape (n,), and a lookup table for drawing particles by weight.

    `guide`: lookup table, shape (n,), int32. Entry k is the first particle to try for random numbers from k / n.
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
def resample(particles, weights, bins, start, kld, injected, share, seen, drawn):
    """Draw particles by weight into `drawn`; return their number, chosen by KLD-sampling.

    `particles`: x, y, heading, shape (3, n), float32 [m, m, rad]. `weights`: normalized. `bins`: histogram bin of each
    particle. `kld`: `min_particles`, `kld_err`, `kld_z` of `AmclParams`. `injected`: random particles, shape (3, f);
    `share`: their share of `drawn`. `seen`: scratch, all False.
    """
    n = particles.shape[1]
    cumulated, guide = np.empty(n), np.empty(n, dtype=np.int32)
    cumulate(weights, cumulated, guide)
    min_particles, error, quantile = kld
    needed = float(min_particles)
    num_bins = num_injected = count = 0
    while count < drawn.shape[1] and count < needed:
        if share > 0.0 and math.floor((count + 1) * share + start) > math.floor(count * share + start):
            drawn[:, count] = injected[:, num_injected]
            num_injected += 1
            is_new = True
        else:
            u = start + count * GOLDEN
            u -= math.floor(u)
            i = guide[int(u * n)]
            while cumulated[i] <= u:
                i += 1
            drawn[0, count], drawn[1, count], drawn[2, count] = particles[0, i], particles[1, i], particles[2, i]
            is_new = not seen[bins[i]]
            seen[bins[i]] = True
        count += 1
        if is_new:
            num_bins += 1
            needed = max(needed, particles_needed(num_bins, error, quantile))
    for i in range(n):
        seen[bins[i]] = False
    return count

"""KLD-sampling: resampling by weight, with as many particles as the spread of the cloud needs."""

import math

import numpy as np
from numba import njit

GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
"""Step between two draws, modulo 1, in the cumulated weights."""


@njit(cache=True, error_model="numpy")
def particles_needed(num_bins, error, quantile):
    """Return how many particles describe a distribution over `num_bins` bins (Fox 2003, equation 7); 0 for one bin.

    For `error` and `quantile` see `AmclParams.kld_err` and `kld_z`.
    """
    if num_bins < 2:
        return 0.0
    k = num_bins - 1.0
    a = 2.0 / (9.0 * k)
    return k / (2.0 * error) * (1.0 - a + math.sqrt(a) * quantile) ** 3


@njit(cache=True, error_model="numpy")
def cumulate(weights, cumulated, guide):
    """Cumulate weights, shape (n,), and tabulate where the search for each n-th part of their sum, 1, begins.

    Entry k of `guide`, shape (n,), int32, is the first particle that a draw of at least k / n can hit.
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
    """Draw particles by weight until there are as many as the bins that they fall into need; return their number.

    Systematic resampling takes every n-th part of the sum of weights in order, so n must be known and one cannot stop
    early. Steps of the golden ratio spread about as evenly, however many there are.

    `particles`: shape (3, n), float32 [m, rad]; `weights`: shape (n,), float64, with the sum 1; `bins`: shape (n,),
    int32, the particles'; `start`: position of the first draw in the cumulated weights, 0 to 1; `kld`: those of
    `AmclParams`; `injected`: shape (3, f), float32, random particles to mix in, each of which counts as a bin, f >=
    `share` * m + 1; `share`: of these among the drawn, 0 to 1; `seen`: shape (num_bins,), bool, all False, scratch;
    `drawn`: shape (3, m), float32, written, room for at most m.
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

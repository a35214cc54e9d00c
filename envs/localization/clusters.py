"""Particle cloud: histogram bins, clusters, mean and covariance, and resampling by KLD-sampling.

`particles`: x, y, heading, shape (3, n), float32 [m, m, rad]. `weights`: shape (n,), float64. `bins`: flat bin indices,
shape (n,), int32.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from lidarnaut.envs.compilation import njit

from .motion_model import cosine, sine

_TOUCHING = np.ones((3, 3, 3))
GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
"""Step of the golden-ratio sequence, which replaces random numbers in resampling."""


class BinRaster(NamedTuple):
    """Histogram bins of poses (x, y, heading), for KLD-sampling and clustering."""

    origin: tuple[float, float]
    """Minimum x and y of the bins, frame of the particles [m]."""
    size: float
    """Side length of a bin along x and y [m]."""
    shape: tuple[int, int, int]
    """Number of bins along y, x and heading."""

    @classmethod
    def over(cls, bounds: tuple[float, float, float, float], size: float, angle: float) -> "BinRaster":
        """Return bins over `bounds` (x_min, y_min, x_max, y_max) [m], of width `size` [m] and heading width `angle`."""
        x_min, y_min, x_max, y_max = bounds
        num_x, num_y = math.ceil((x_max - x_min) / size), math.ceil((y_max - y_min) / size)
        return cls((x_min, y_min), size, (num_y, num_x, max(1, round(2.0 * math.pi / angle))))


@njit(cache=True, error_model="numpy")
def find_bins(particles, raster, bins):
    """Write each particle's histogram bin to `bins`; return the cloud's largest extent along x, y or heading [bins]."""
    xs, ys, thetas = particles[0], particles[1], particles[2]
    per_metre = np.float32(1.0 / raster.size)
    per_radian = np.float32(raster.shape[2] / (2.0 * math.pi))
    offset_x, offset_y = np.float32(raster.origin[0]), np.float32(raster.origin[1])
    num_y, num_x, num_angles = np.int32(raster.shape[0]), np.int32(raster.shape[1]), np.int32(raster.shape[2])
    first, last_col, last_row = np.float32(0.0), np.float32(num_x - 1), np.float32(num_y - 1)
    zero, one = np.int32(0), np.int32(1)
    low_row, low_col, low_angle = num_y, num_x, num_angles
    high_row, high_col, high_angle = zero, zero, zero
    for i in range(xs.shape[0]):
        # Clamp first: int32 overflows above 2e9.
        col = np.int32(min(max((xs[i] - offset_x) * per_metre, first), last_col))
        row = np.int32(min(max((ys[i] - offset_y) * per_metre, first), last_row))
        angle = min(np.int32((thetas[i] + np.float32(math.pi)) * per_radian), num_angles - one)
        bins[i] = np.int32(np.int32(row * num_x + col) * num_angles + angle)
        low_row, high_row = min(low_row, row), max(high_row, row)
        low_col, high_col = min(low_col, col), max(high_col, col)
        low_angle, high_angle = min(low_angle, angle), max(high_angle, angle)
    return 1 + max(high_row - low_row, high_col - low_col, high_angle - low_angle)


def heaviest_cluster(bins: np.ndarray, weights: np.ndarray, raster: BinRaster) -> tuple[float, np.ndarray]:
    """Find the heaviest cluster of particles, in connected histogram bins.

    Return its weight, and the particle weights, set to 0 outside of the cluster.
    """
    rows, cols, angles = np.unravel_index(bins, raster.shape)
    rows, cols = rows - rows.min(), cols - cols.min()
    occupied = np.zeros((rows.max() + 1, cols.max() + 1, raster.shape[2] + 1), dtype=bool)
    occupied[rows, cols, angles] = True
    # Heading is periodic: merge clusters that meet at +-pi.
    again = occupied[:, :, -1] = occupied[:, :, 0]
    labels, count = ndimage.label(occupied, _TOUCHING)
    if count == 1:
        return 1.0, weights
    clusters = np.arange(count + 1)
    for first, last in set(zip(labels[again, 0].tolist(), labels[again, -1].tolist())):
        clusters[clusters == clusters[last]] = clusters[first]
    clusters = clusters[labels[rows, cols, angles]]
    totals = np.bincount(clusters, weights)
    is_member = clusters == totals.argmax()
    if is_member.all():
        return 1.0, weights
    return float(totals.max()), np.where(is_member, weights, 0.0)


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
def mean_and_covariance(particles, weights, total, covariance):
    """Return the weighted mean of particles: x [m], y [m] and (circular) heading [rad].

    Their covariance, shape (3, 3), is written to `covariance`. `total`: sum of `weights`.
    """
    xs, ys, thetas = particles[0], particles[1], particles[2]
    # Relative to the first particle, for precision.
    x0, y0 = xs[0], ys[0]
    x = y = c = s = 0.0
    for i in range(xs.shape[0]):
        w = weights[i]
        x += w * (xs[i] - x0)
        y += w * (ys[i] - y0)
        c += w * cosine(thetas[i])
        s += w * sine(thetas[i])
    x, y, theta = x / total, y / total, math.atan2(s, c)
    mean_x, mean_y, mean_theta = np.float32(x0 + x), np.float32(y0 + y), np.float32(theta)
    turn, half = np.float32(2.0 * math.pi), np.float32(0.5)
    xx = xy = yy = xt = yt = tt = 0.0
    for i in range(xs.shape[0]):
        w = weights[i]
        dx, dy, dt = xs[i] - mean_x, ys[i] - mean_y, thetas[i] - mean_theta
        dt -= turn * np.floor(dt / turn + half)
        xx += w * (dx * dx)
        xy += w * (dx * dy)
        yy += w * (dy * dy)
        xt += w * (dx * dt)
        yt += w * (dy * dt)
        tt += w * (dt * dt)
    covariance[0, 0], covariance[1, 1], covariance[2, 2] = xx / total, yy / total, tt / total
    covariance[0, 1] = covariance[1, 0] = xy / total
    covariance[0, 2] = covariance[2, 0] = xt / total
    covariance[1, 2] = covariance[2, 1] = yt / total
    return x0 + x, y0 + y, theta


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

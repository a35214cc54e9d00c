"""What a cloud of particles says: its bins, its clusters, mean and covariance."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from .motion_model import cosine, sine


class BinRaster(NamedTuple):
    """A raster over x, y and heading, with a border of one bin in x and y that no particle falls into."""

    x: float
    """Where the raster's corner lies in the map frame [m]."""
    y: float
    """Where the raster's corner lies in the map frame [m]."""
    size: float
    """Side of a bin [m]."""
    num_x: int
    """Bins along x."""
    num_y: int
    """Bins along y."""
    num_angles: int
    """Bins in a turn."""

    @classmethod
    def over(cls, bounds: tuple[float, float, float, float], size: float, angle: float) -> "BinRaster":
        """Lay a raster over a map.

        Args:
            bounds: of the map, (x_min, y_min, x_max, y_max) [m].
            size: side of a bin [m].
            angle: size of a bin in heading [rad].
        """
        x_min, y_min, x_max, y_max = bounds
        num_x, num_y = math.ceil((x_max - x_min) / size) + 2, math.ceil((y_max - y_min) / size) + 2
        return cls(x_min - size, y_min - size, size, num_x, num_y, max(1, round(2.0 * math.pi / angle)))

    @property
    def num_bins(self) -> int:
        """Number of bins."""
        return self.num_x * self.num_y * self.num_angles


@njit(cache=True, error_model="numpy")
def find_bins(particles, raster, bins):
    """Write the bins (n,), int32, of particles (3, n), float32; what lies off the map counts to its edge."""
    xs, ys, thetas = particles[0], particles[1], particles[2]
    per_metre = np.float32(1.0 / raster.size)
    per_radian = np.float32(raster.num_angles / (2.0 * math.pi))
    offset_x, offset_y = np.float32(raster.x), np.float32(raster.y)
    num_x, num_y, num_angles = np.int32(raster.num_x), np.int32(raster.num_y), np.int32(raster.num_angles)
    one = np.int32(1)
    for i in range(xs.shape[0]):
        col = min(max(np.int32((xs[i] - offset_x) * per_metre), one), num_x - np.int32(2))
        row = min(max(np.int32((ys[i] - offset_y) * per_metre), one), num_y - np.int32(2))
        angle = min(np.int32((thetas[i] + np.float32(math.pi)) * per_radian), num_angles - one)
        bins[i] = np.int32(np.int32(row * num_x + col) * num_angles + angle)


@njit(cache=True, error_model="numpy")
def _fill(bin_of_slot, slot_of_bin, num_slots, raster, labels):
    """Number the groups of bins that touch, by side or corner; return how many groups there are."""
    labels[:num_slots] = -1
    waiting = np.empty(num_slots, dtype=np.int32)
    count = 0
    for first in range(num_slots):
        if labels[first] >= 0:
            continue
        labels[first] = count
        waiting[0] = first
        num_waiting = 1
        while num_waiting > 0:
            num_waiting -= 1
            here = bin_of_slot[waiting[num_waiting]]
            place, angle = here // raster.num_angles, here % raster.num_angles
            for d_row in range(-1, 2):
                for d_col in range(-1, 2):
                    for d_angle in range(-1, 2):
                        turned = (angle + d_angle) % raster.num_angles
                        there = (place + d_row * raster.num_x + d_col) * raster.num_angles + turned
                        slot = slot_of_bin[there]
                        if slot < num_slots and bin_of_slot[slot] == there and labels[slot] < 0:
                            labels[slot] = count
                            waiting[num_waiting] = slot
                            num_waiting += 1
        count += 1
    return count


@njit(cache=True, error_model="numpy")
def heaviest_cluster(bins, weights, raster, slot_of_bin, bin_of_slot, members):
    """Find the particles of the heaviest cluster: those in touching bins.

    Args:
        bins: shape (n,), int32, the particles' bins.
        weights: shape (n,), float64, with the sum 1.
        raster: the bins, `BinRaster`.
        slot_of_bin: shape (num_bins,), int32, scratch; may hold anything from 0 on.
        bin_of_slot: shape (>= n,), int32, scratch.
        members: shape (n,), float64, written: the weights of the cluster's particles, 0 for the others.

    Returns:
        The cluster's weight.
    """
    n = bins.shape[0]
    slots = np.empty(n, dtype=np.int32)
    num_slots = 0
    for i in range(n):
        slot = slot_of_bin[bins[i]]
        if slot >= num_slots or bin_of_slot[slot] != bins[i]:
            slot = num_slots
            slot_of_bin[bins[i]] = slot
            bin_of_slot[slot] = bins[i]
            num_slots += 1
        slots[i] = slot
    labels = np.empty(num_slots, dtype=np.int32)
    count = _fill(bin_of_slot, slot_of_bin, num_slots, raster, labels)
    if count == 1:
        members[:] = weights
        return 1.0
    totals = np.zeros(count)
    for i in range(n):
        totals[labels[slots[i]]] += weights[i]
    heaviest = np.argmax(totals)
    for i in range(n):
        members[i] = weights[i] if labels[slots[i]] == heaviest else 0.0
    return totals[heaviest]


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
def mean_and_covariance(particles, weights, total, covariance):
    """Compute the weighted mean and covariance of particles.

    Args:
        particles: shape (3, n), float32, x, y, heading [m, rad].
        weights: shape (n,), float64.
        total: their sum.
        covariance: shape (3, 3), float64, written [m, m, rad]; headings differ by less than half a turn from the mean.

    Returns:
        The mean x, y [m] and heading [rad], which is the direction of the sum of unit vectors.
    """
    xs, ys, thetas = particles[0], particles[1], particles[2]
    # Seen from the first particle, so that nothing is lost far from the origin.
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

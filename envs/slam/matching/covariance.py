import math
from typing import NamedTuple, Self

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.robots import OdometryNoise

NOISE_PER_HIT = 0.02
"""Part of the scan-matching Hessian due to noise in map cells, per scan point [1/cells^2]; subtracted."""
SLIP_FACTOR = 20.0
"""Heading noise per metre of odometry in contact, divided by the noise without contact."""
LEAST_DETERMINANT, LEAST_EIGENVALUE, TINY = 1e-6, 1e-13, 1e-100
"""Least determinant of a correlation matrix that is inverted by its minors, which lose digits by cancellation; least
eigenvalue of other correlation matrices; least diagonal entry."""


class NoiseRecord(NamedTuple):
    """Odometry noise model as a named tuple for Numba kernels."""

    position_std: float
    position_per_metre: float
    heading_std: float
    heading_per_radian: float
    heading_per_metre: float

    @classmethod
    def of(cls, noise: OdometryNoise) -> Self:
        return cls(*(float(getattr(noise, field)) for field in cls._fields))

    def in_contact(self, slip: float) -> Self:
        """Return the noise model for motion that includes `slip` [m] of odometry in contact, where wheels may spin."""
        heading_std = self.heading_std + SLIP_FACTOR * self.heading_per_metre * slip
        return self._replace(position_std=self.position_std + slip, heading_std=heading_std)


@njit(cache=True, error_model="numpy")
def motion_stds(noise, travelled, turn):
    """Return odometry standard deviations of position [m] and heading [rad] after a distance [m] and turn [rad]."""
    heading_std = noise.heading_std + noise.heading_per_radian * abs(turn) + noise.heading_per_metre * travelled
    return noise.position_std + noise.position_per_metre * travelled, heading_std


@njit(cache=True, error_model="numpy")
def without_noise(h_xx, h_xy, h_xt, h_yy, h_yt, noise):
    """Subtract information due to map noise from a scan-matching Hessian; return its entries xx, xy, xt, yy, yt.

    Noise would make positions along corridors seem known. `noise`: reduction of position eigenvalues.
    """
    mean, half = 0.5 * (h_xx + h_yy), 0.5 * (h_xx - h_yy)
    spread = math.sqrt(half * half + h_xy * h_xy)
    large, small = mean + spread, max(mean - spread, 0.0)
    if not large > noise:
        return 0.0, 0.0, 0.0, 0.0, 0.0
    keep_large = math.sqrt((large - noise) / large)
    keep_small = math.sqrt(max(small - noise, 0.0) / small) if small > 0.0 else 0.0
    angle = 0.5 * math.atan2(h_xy, half)
    c, s = math.cos(angle), math.sin(angle)
    s_xx = c * c * keep_large + s * s * keep_small
    s_yy = s * s * keep_large + c * c * keep_small
    s_xy = c * s * (keep_large - keep_small)
    a, b, d = s_xx * h_xx + s_xy * h_xy, s_xx * h_xy + s_xy * h_yy, s_xy * h_xy + s_yy * h_yy
    e = s_xy * h_xx + s_yy * h_xy
    return (
        a * s_xx + b * s_xy,
        a * s_xy + b * s_yy,
        s_xx * h_xt + s_xy * h_yt,
        e * s_xy + d * s_yy,
        s_xy * h_xt + s_yy * h_yt,
    )


@njit(cache=True, error_model="numpy")
def invert(p, out):
    """Write the inverse of a symmetric positive definite 3 x 3 matrix to `out`; return the determinant.

    The result is positive definite even if `p` is singular or, by rounding, indefinite: see `LEAST_EIGENVALUE`.
    """
    m_xx, m_xy = p[1, 1] * p[2, 2] - p[1, 2] * p[1, 2], p[0, 2] * p[1, 2] - p[0, 1] * p[2, 2]
    m_xt = p[0, 1] * p[1, 2] - p[0, 2] * p[1, 1]
    determinant = p[0, 0] * m_xx + p[0, 1] * m_xy + p[0, 2] * m_xt
    if not determinant > LEAST_DETERMINANT * p[0, 0] * p[1, 1] * p[2, 2]:
        scale = np.sqrt(np.maximum(np.diag(p), TINY))
        values, vectors = np.linalg.eigh(p / np.outer(scale, scale))
        values = np.maximum(values, LEAST_EIGENVALUE)
        root = np.ascontiguousarray(vectors / np.outer(scale, np.sqrt(values)))
        out[:] = root @ root.T
        return np.prod(values) * np.prod(scale) ** 2
    out[0, 0] = m_xx / determinant
    out[0, 1] = out[1, 0] = m_xy / determinant
    out[0, 2] = out[2, 0] = m_xt / determinant
    out[1, 1] = (p[0, 0] * p[2, 2] - p[0, 2] * p[0, 2]) / determinant
    out[1, 2] = out[2, 1] = (p[0, 1] * p[0, 2] - p[0, 0] * p[1, 2]) / determinant
    out[2, 2] = (p[0, 0] * p[1, 1] - p[0, 1] * p[0, 1]) / determinant
    return determinant


@njit(cache=True, error_model="numpy")
def predict_covariance(p, dx, dy, position_std, heading_std):
    """Propagate a pose covariance by an odometry motion (dx, dy) [m], map frame, in place.

    P <- F P F^T + diag(position_std^2, position_std^2, heading_std^2), with motion Jacobian F.
    """
    variance = p[2, 2]
    x, y = p[0, 2], p[1, 2]
    p[0, 0] += position_std * position_std - 2.0 * dy * x + dy * dy * variance
    p[0, 1] += dx * x - dy * y - dx * dy * variance
    p[1, 1] += position_std * position_std + 2.0 * dx * y + dx * dx * variance
    p[0, 2], p[1, 2] = x - dy * variance, y + dx * variance
    p[2, 2] += heading_std * heading_std
    p[1, 0], p[2, 0], p[2, 1] = p[0, 1], p[0, 2], p[1, 2]


@njit(cache=True, error_model="numpy")
def correct_covariance(p, fit, num_points, residual_variance, resolution):
    """Correct a pose covariance by a scan match, in place: P <- (P^-1 + H / k)^-1.

    H is the Hessian of `fit`, k the residual variance, `resolution` the cell side [m]. Returns new det P / old det P.
    """
    xx, xy, xt, yy, yt = without_noise(fit.h_xx, fit.h_xy, fit.h_xt, fit.h_yy, fit.h_yt, NOISE_PER_HIT * num_points)
    information = p.copy()
    before = invert(p, information)
    per_cell = 1.0 / (resolution * residual_variance)
    information[0, 0] += xx * per_cell / resolution
    information[0, 1] += xy * per_cell / resolution
    information[1, 1] += yy * per_cell / resolution
    information[0, 2] += xt * per_cell
    information[1, 2] += yt * per_cell
    information[2, 2] += fit.h_tt / residual_variance
    return 1.0 / (invert(information, p) * before)


def position_std(covariance: np.ndarray) -> float:
    """Return the position standard deviation in the most uncertain direction [m]."""
    (xx, xy, _), (_, yy, _), _ = covariance.tolist()
    return math.sqrt(0.5 * (xx + yy) + math.hypot(0.5 * (xx - yy), xy))

"""Odometry motion model."""

import math

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry import Pose2D, wrap_angle

from .amcl_params import AmclParams

MIN_TRANSLATION = 0.01
_MEAN = np.int32(2 * 65535)
_SCALE = np.float32(1.0 / math.sqrt((2.0**32 - 1.0) / 3.0))
_PI = np.float32(math.pi)
_TURN = np.float32(2.0 * math.pi)
_HALF = np.float32(0.5)


@njit(cache=True, error_model="numpy", inline="always")
def normal(seed, index):
    """Return an approximately standard normal pseudo-random number, determined by `seed` and `index` (uint64).

    Sum of four uniforms from SplitMix64 (Steele et al. 2014).
    """
    word = seed + (index + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    word = (word ^ (word >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    word = (word ^ (word >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    word = word ^ (word >> np.uint64(31))
    total = np.int32(word & np.uint64(0xFFFF)) + np.int32((word >> np.uint64(16)) & np.uint64(0xFFFF))
    total += np.int32((word >> np.uint64(32)) & np.uint64(0xFFFF)) + np.int32(word >> np.uint64(48))
    return np.float32(total - _MEAN) * _SCALE


@njit(cache=True, error_model="numpy", inline="always")
def sine(theta):
    """Return the sine of a float32 angle in [-pi, pi] with an error below 1e-6, by a vectorizable polynomial."""
    t = _PI - theta if theta > _HALF * _PI else theta
    t = -_PI - theta if theta < -_HALF * _PI else t
    t2 = t * t
    p = np.float32(-2.5052108e-8)
    p = p * t2 + np.float32(2.7557319e-6)
    p = p * t2 + np.float32(-1.9841270e-4)
    p = p * t2 + np.float32(8.3333333e-3)
    p = p * t2 + np.float32(-1.6666667e-1)
    return t + t * t2 * p


@njit(cache=True, error_model="numpy", inline="always")
def wrap(theta):
    """Wrap a float32 angle of at most a few turns to [-pi, pi] [rad]."""
    return theta - _TURN * np.floor(theta / _TURN + _HALF)


@njit(cache=True, error_model="numpy", inline="always")
def cosine(theta):
    """Return the cosine of a float32 angle in [-pi, pi]; error as in `sine`."""
    t = theta + _HALF * _PI
    return sine(t - _TURN if t > _PI else t)


@njit(cache=True, error_model="numpy")
def _move(particles, motion, stds, seed):
    xs, ys, thetas = particles[0], particles[1], particles[2]
    rot1, trans, rot2 = np.float32(motion[0]), np.float32(motion[1]), np.float32(motion[2])
    std1, std_trans, std2 = np.float32(stds[0]), np.float32(stds[1]), np.float32(stds[2])
    count = np.uint64(xs.shape[0])
    for i in range(xs.shape[0]):
        k = np.uint64(i)
        heading = wrap(thetas[i] + rot1 + std1 * normal(seed, k))
        distance = trans + std_trans * normal(seed, k + count)
        xs[i] += distance * cosine(heading)
        ys[i] += distance * sine(heading)
        thetas[i] = wrap(heading + rot2 + std2 * normal(seed, k + count + count))


def move_particles(particles: np.ndarray, motion: Pose2D, params: AmclParams, rng: np.random.Generator) -> None:
    """Move particles by the odometry motion model of a differential drive (Thrun et al. 2005, table 5.6), as in Nav2.

    `particles`: x, y, heading, shape (3, n), float32 [m, m, rad]. `motion`: odometry pose of the base in the last base
    frame.
    """
    trans = math.hypot(motion.x, motion.y)
    rot1 = math.atan2(motion.y, motion.x) if trans >= MIN_TRANSLATION else 0.0
    rot2 = wrap_angle(motion.theta - rot1)
    # Driving backwards is as precise as forwards.
    noise1, noise2 = (min(abs(rot), math.pi - abs(rot)) for rot in (rot1, rot2))
    # One turn means unknown heading; `wrap` handles few turns.
    stds = (
        min(math.sqrt(params.alpha1 * noise1**2 + params.alpha2 * trans**2), math.tau),
        math.sqrt(params.alpha3 * trans**2 + params.alpha4 * (noise1**2 + noise2**2)),
        min(math.sqrt(params.alpha1 * noise2**2 + params.alpha2 * trans**2), math.tau),
    )
    _move(particles, (rot1, trans, rot2), stds, rng.integers(1 << 64, dtype=np.uint64))

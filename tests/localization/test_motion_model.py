import math

import numpy as np
import pytest
from numba import njit

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.localization import AmclParams
from lidarnaut.envs.localization.motion_model import move_particles, normal


@njit
def _draw(seed, out):
    for k in range(out.size):
        out[k] = normal(seed, np.uint64(k))


def test_noise_is_nearly_normal():
    draws = np.empty(1_000_000)
    _draw(np.uint64(12345), draws)
    assert draws.mean() == pytest.approx(0.0, abs=0.004)
    assert draws.std() == pytest.approx(1.0, abs=0.003)
    share = [np.mean(np.abs(draws) < k) for k in (0.5, 1.0, 2.0, 3.0)]
    np.testing.assert_allclose(share, [0.383, 0.683, 0.954, 0.9973], atol=0.015)
    assert abs(np.corrcoef(draws[:-1], draws[1:])[0, 1]) < 0.005
    other = np.empty_like(draws)
    _draw(np.uint64(12346), other)
    assert abs(np.corrcoef(draws, other)[0, 1]) < 0.005


def test_without_noise_particles_move_as_odometry_does():
    params = AmclParams(alpha1=0, alpha2=0, alpha3=0, alpha4=0)
    rng = np.random.default_rng(0)
    for motion in (Pose2D(0.3, 0.1, 0.4), Pose2D(-0.3, 0.05, -0.2), Pose2D(0.001, 0.0, 2.0), Pose2D(0.0, 0.0, -3.0)):
        poses = rng.uniform(-3, 3, (3, 50))
        particles = poses.astype(np.float32)
        move_particles(particles, motion, params, rng)
        expected = np.array([Pose2D(*pose).compose(motion) for pose in poses.T.tolist()]).T
        np.testing.assert_allclose(particles[:2], expected[:2], atol=2e-3)  # a motion under 1 cm has no direction
        np.testing.assert_allclose(np.cos(particles[2]), np.cos(expected[2]), atol=1e-5)


@pytest.mark.parametrize("backwards", [False, True])
def test_spread_follows_the_alphas(backwards):
    params = AmclParams(alpha1=0.04, alpha2=0.01, alpha3=0.09, alpha4=0.02)
    turn, distance = 0.5, 2.0
    sign = -1.0 if backwards else 1.0
    motion = Pose2D(sign * distance * math.cos(turn), sign * distance * math.sin(turn), turn)
    particles = np.zeros((3, 200_000), dtype=np.float32)
    move_particles(particles, motion, params, np.random.default_rng(3))
    theta_variance = 0.04 * turn**2 + 0.01 * distance**2 + 0.01 * distance**2
    distance_variance = 0.09 * distance**2 + 0.02 * turn**2
    assert particles[2].std() == pytest.approx(math.sqrt(theta_variance), rel=0.02)
    assert np.hypot(particles[0], particles[1]).std() == pytest.approx(math.sqrt(distance_variance), rel=0.03)

import math

import numpy as np

from envs.slam.gmapping.gmapping import normalized_weights, spread, systematic_resample


def test_weights_from_logarithms_far_below_zero():
    weights = normalized_weights(np.log([1.0, 2.0, 5.0]) - 4000.0)
    np.testing.assert_allclose(weights, [0.125, 0.25, 0.625])


def test_systematic_resampling_by_hand():
    weights = np.array([0.1, 0.5, 0.0, 0.4])
    assert systematic_resample(weights, 0.0).tolist() == [0, 1, 1, 3]  # 0, 0.25, 0.5, 0.75
    assert systematic_resample(weights, 0.5).tolist() == [1, 1, 3, 3]  # 0.125, 0.375, 0.625, 0.875


def test_each_particle_is_chosen_as_often_as_its_weight_says():
    rng, counts = np.random.default_rng(0), np.zeros(12)
    weights = rng.dirichlet(np.full(12, 0.5))
    for _ in range(4000):
        chosen = np.bincount(systematic_resample(weights, rng.random()), minlength=12)
        assert (np.abs(chosen - 12 * weights) < 1.0).all()
        counts += chosen
    np.testing.assert_allclose(counts / 4000, 12 * weights, atol=0.05)


def test_spread_by_hand_and_across_half_a_turn():
    poses = np.array([[1.0, 0.0, math.pi - 0.1], [3.0, 0.0, -math.pi + 0.1]])
    covariance = spread(poses, np.array([0.5, 0.5]), poses[0])
    np.testing.assert_allclose(covariance, [[1.0, 0.0, 0.1], [0.0, 0.0, 0.0], [0.1, 0.0, 0.01]], atol=1e-12)

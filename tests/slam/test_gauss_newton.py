import math

import numpy as np
import pytest

from lidarnaut.envs.slam.matching.correlative import TURN_STEP, search_window
from lidarnaut.envs.slam.matching.covariance import correct_covariance, invert, predict_covariance, without_noise
from lidarnaut.envs.slam.matching.gauss_newton import Fit, PosePrior, evaluate, refine

NO_PRIOR = PosePrior(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def occupancy_at(occupancy, scale, points, x, y, theta):
    """M at the hits, shape (n,), interpolated between cell centres; one half outside of the map."""
    c, s = math.cos(theta), math.sin(theta)
    u = (c * points[0] - s * points[1] + x) * scale - 0.5
    v = (s * points[0] + c * points[1] + y) * scale - 0.5
    padded = np.where(occupancy < 0, 0.5, occupancy / 100.0)
    height, width = occupancy.shape
    inside = (u >= 0) & (v >= 0) & (u < width - 1) & (v < height - 1)
    col, row = (np.where(inside, np.floor(w), 0).astype(int) for w in (u, v))
    a, b = u - col, v - row
    low = (1 - a) * padded[row, col] + a * padded[row, col + 1]
    high = (1 - a) * padded[row + 1, col] + a * padded[row + 1, col + 1]
    return np.where(inside, (1 - b) * low + b * high, 0.5)


def random_case(seed):
    rng = np.random.default_rng(seed)
    occupancy = rng.integers(-1, 101, (30, 40)).astype(np.int8)
    return occupancy, rng.normal(scale=8.0, size=(2, 50)).astype(np.float32)


@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_evaluate_matches_the_slow_reference(scale):
    occupancy, points = random_case(1)
    pose = np.array([19.3, 14.8, 0.7]) / (scale, scale, 1.0)
    fit = evaluate((occupancy, occupancy), round(1 / scale) - 1, points, 50, *pose)
    exact = points.astype(float)
    m = occupancy_at(occupancy, scale, exact, *pose)
    step = 1e-6
    gradient = np.stack([occupancy_at(occupancy, scale, exact, *(pose + step * unit)) - m for unit in np.eye(3)]) / step
    h, b = gradient @ gradient.T, gradient @ (1.0 - m)
    np.testing.assert_allclose(fit[:6], [h[0, 0], h[0, 1], h[0, 2], h[1, 1], h[1, 2], h[2, 2]], rtol=1e-3)
    np.testing.assert_allclose(fit[6:9], b, rtol=1e-3, atol=1e-4)
    assert fit.total == pytest.approx(m.sum())
    assert fit.squares == pytest.approx(((1.0 - m) ** 2).sum())


def walls():
    """An L of two blurred walls, 60 x 60 cells, and the same in cells twice as wide."""

    def level(side):
        rows, cols = (np.arange(60 // side) + 0.5) * side, (np.arange(60 // side) + 0.5) * side
        near = np.minimum(np.abs(rows[:, None] - 10.5), np.abs(cols[None, :] - 10.5))
        return np.round(100.0 * np.exp(-((near / 2.0) ** 2))).astype(np.int8)

    return level(1), level(2)


def hits(x, y, theta):
    """Hits on the walls seen from a pose, shape (2, 80), float32, base frame."""
    along = np.linspace(15.0, 50.0, 40)
    world = np.stack([np.r_[along, np.full(40, 10.5)], np.r_[np.full(40, 10.5), along]]) - [[x], [y]]
    c, s = math.cos(theta), math.sin(theta)
    return (np.array([[c, s], [-s, c]]) @ world).astype(np.float32)


def test_refine_finds_the_pose_and_the_prior_holds_it():
    levels, points = walls(), hits(30.0, 25.0, 0.4)
    start = (31.5, 23.8, 0.45)
    *found, fit = refine(levels, 2, points, 80, start, NO_PRIOR, 20, 10)
    np.testing.assert_allclose(found, (30.0, 25.0, 0.4), atol=0.1)
    assert fit.total > 79.0
    firm = PosePrior(*start, 1e6, 0.0, 0.0, 1e6, 0.0, 1e6)
    *held, _ = refine(levels, 2, points, 80, start, firm, 10, 10)
    np.testing.assert_allclose(held, start, atol=1e-3)
    # With a strong prior along x only, the other components are found.
    across = PosePrior(30.2, 24.0, 0.4, 1e6, 0, 0, 0, 0, 0)
    *partly, _ = refine(levels, 2, points, 80, (30.0, 23.8, 0.4), across, 10, 10)
    np.testing.assert_allclose(partly[:2], (30.2, 25.0), atol=0.1)


@pytest.mark.parametrize("unknown", [50, 0])
@pytest.mark.parametrize("x", [19.3, 3.0])  # well inside, and with a window that leaves the map
def test_search_tries_every_pose_of_the_window(unknown, x):
    occupancy, points = random_case(3)
    pose, stds = (x, 14.8, 0.7), (2.0, 0.03)
    best, best_pose = -math.inf, None
    for turn in range(-2, 3):
        theta = pose[2] + turn * TURN_STEP
        c, s = math.cos(theta), math.sin(theta)
        col = np.floor(c * points[0].astype(float) - s * points[1] + pose[0]).astype(int)
        row = np.floor(s * points[0].astype(float) + c * points[1] + pose[1]).astype(int)
        for up in range(-4, 5):
            for right in range(-4, 5):
                inside = (row + up >= 0) & (col + right >= 0) & (row + up < 30) & (col + right < 40)
                values = occupancy[np.clip(row + up, 0, 29), np.clip(col + right, 0, 39)].astype(int)
                mean = np.where(inside & (values >= 0), values, unknown).mean() / 100.0
                score = mean - 0.01 * ((up**2 + right**2) / stds[0] ** 2 + (turn * TURN_STEP / stds[1]) ** 2)
                if score > best:
                    best, best_pose = score, (pose[0] + right, pose[1] + up, theta)
    np.testing.assert_allclose(search_window(occupancy, 1.0, points, 50, pose, stds, unknown), best_pose, rtol=1e-12)


def test_covariance_follows_the_motion():
    rng = np.random.default_rng(4)
    a = rng.normal(size=(3, 4))
    p = a @ a.T
    f = np.array([[1.0, 0.0, -0.7], [0.0, 1.0, 1.2], [0.0, 0.0, 1.0]])
    expected = f @ p @ f.T + np.diag([0.3**2, 0.3**2, 0.1**2])
    predict_covariance(p, 1.2, 0.7, 0.3, 0.1)
    np.testing.assert_allclose(p, expected, rtol=1e-12)


def test_covariance_after_a_match_is_the_inverse_of_the_joined_information():
    rng = np.random.default_rng(5)
    a, g = rng.normal(size=(3, 4)), rng.normal(size=(3, 40))
    p, h = a @ a.T, g @ g.T
    i, j = np.triu_indices(3)
    fit = Fit(*h[i, j], 0.0, 0.0, 0.0, 0.0, 0.0)
    inverse = np.empty((3, 3))
    invert(p, inverse)
    np.testing.assert_allclose(inverse, np.linalg.inv(p), rtol=1e-9)
    per_metre = np.diag([1 / 0.05, 1 / 0.05, 1.0])
    expected = np.linalg.inv(np.linalg.inv(p) + per_metre @ h @ per_metre / 0.3)
    correct_covariance(p, fit, 0, 0.3, 0.05)
    np.testing.assert_allclose(p, expected, rtol=1e-8)


@pytest.mark.parametrize("spread", [1e2, 1e6, 1e10])
def test_covariances_stay_positive_definite_where_directions_are_unobservable(spread):
    rng = np.random.default_rng(8)
    inverse, p = np.empty((3, 3)), np.zeros((3, 3))
    for k in range(300):
        # Most matches observe one direction of three, of any mixture of position and heading.
        g = rng.normal(size=(3, 1 if k % 50 else 40))
        i, j = np.triu_indices(3)
        predict_covariance(p, *rng.normal(size=2), np.sqrt(spread) * 1e-3, np.sqrt(spread) * 1e-3)
        shrunk = correct_covariance(p, Fit(*(spread * g @ g.T)[i, j], *[0.0] * 5), 0, 0.3, 0.05)
        assert 0.0 < shrunk <= 1.0 + 1e-9
        invert(p, inverse)
        for matrix in (p, inverse):
            np.testing.assert_allclose(matrix, matrix.T, rtol=1e-9, atol=1e-12 * np.trace(matrix))
            assert np.linalg.eigvalsh(matrix)[0] > -1e-12 * np.trace(matrix)


def test_a_nearly_singular_matrix_is_inverted_accurately():
    turn = np.linalg.qr(np.random.default_rng(9).normal(size=(3, 3)))[0]
    values = np.array([1e4, 1e-6, 3e-6])  # a round room: turning about its center is unobservable
    inverse = np.empty((3, 3))
    determinant = invert(turn @ np.diag(values) @ turn.T, inverse)
    np.testing.assert_allclose(inverse, turn @ np.diag(1.0 / values) @ turn.T, atol=1e-5 / values.min())
    assert determinant == pytest.approx(values.prod(), rel=1e-4)
    invert(np.zeros((3, 3)), inverse)
    assert np.isfinite(inverse).all()
    assert (np.diag(inverse) > 0.0).all()


def test_noise_is_taken_off_both_directions():
    rng = np.random.default_rng(6)
    g = rng.normal(size=(3, 40))
    h = g @ g.T
    values, vectors = np.linalg.eigh(h[:2, :2])
    for noise in (1.0, 0.5 * (values[0] + values[1]), 2.0 * values[1]):
        xx, xy, xt, yy, yt = without_noise(h[0, 0], h[0, 1], h[0, 2], h[1, 1], h[1, 2], noise)
        left = vectors @ np.diag(np.maximum(values - noise, 0.0)) @ vectors.T
        np.testing.assert_allclose([[xx, xy], [xy, yy]], left, atol=1e-9)
        whole = np.array([[xx, xy, xt], [xy, yy, yt], [xt, yt, h[2, 2]]])
        assert np.linalg.eigvalsh(whole)[0] > -1e-9

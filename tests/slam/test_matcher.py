import numpy as np
import pytest

from lidarnaut.envs.estimation.scan_points import ScanGeometry, project_hits
from lidarnaut.envs.slam.grid_map import FULL_OCCUPANCY, unvisited_word
from lidarnaut.envs.slam.matcher import SearchParams, match

from . import reference


def random_case(seed, size=(40, 50), num_points=60):
    rng = np.random.default_rng(seed)
    words = (rng.integers(0, 1 << 18, size) << 12 | rng.integers(1, 4096, size)).astype(np.int32)
    unvisited = unvisited_word(-1.0)
    words[rng.random(size) < 0.2] = unvisited
    values = (words >> 12) / (1 << 18)
    points = rng.normal(scale=4.0, size=(2, num_points)).astype(np.float32)
    return rng, words, values, unvisited, points


@pytest.mark.parametrize("seed", range(4))
def test_search_matches_the_slow_reference(seed):
    rng, words, values, unvisited, points = random_case(seed)
    pose = (25.0, 20.0, 0.3) if seed % 2 else (2.0, 37.0, -2.0)  # well inside, and in a corner
    noise = rng.standard_normal((300, 3))
    # With 30 failures allowed, improvements after more than 10 halve the spread.
    params = SearchParams(1.5, 0.2, 30, 300, unvisited)
    trace = np.empty((301, 5))
    found = match(words, points, 60, pose, params, noise, trace)
    expected, expected_cost, tested = reference.search(values, points, pose, 1.5, 0.2, 30, 300, noise, -1.0)
    assert 60 - found.total / FULL_OCCUPANCY == pytest.approx(expected_cost, abs=1e-9)
    np.testing.assert_allclose(found[:3], expected, rtol=1e-12)
    assert found.tried + 1 == len(tested)
    assert found.accepted + 1 == sum(was for *_, was in tested) > 2
    seen = trace[: found.tried + 1]
    np.testing.assert_allclose(seen[:, :3], [pose for pose, *_ in tested], atol=1e-9)
    np.testing.assert_allclose(60 - seen[:, 3] / FULL_OCCUPANCY, [cost for _, cost, _ in tested], atol=1e-9)
    assert seen[1:, 4].tolist() == [is_better for *_, is_better in tested[1:]]


def test_the_prior_holds_the_search_by_the_squared_distance_from_the_start():
    # Each cell to the right gains 32; distances of 1 and 2 lose 20 and 80.
    words = np.tile(np.arange(40, dtype=np.int32) << 17, (3, 1))
    point, noise = np.zeros((2, 1), dtype=np.float32), np.zeros((20, 3))
    noise[:2, 0] = 1.0
    free = SearchParams(1.0, 1.0, 6, 20, 0)
    for params, x, total in ((free, 4.5, 4 * 32), (free._replace(position_penalty=20.0), 3.5, 3 * 32 - 20)):
        found = match(words, point, 1, (2.5, 1.5, 0.0), params, noise, np.empty((21, 5)))
        assert (found.x, found.total) == (x, total)
    noise[:2] = 0.0, 0.0, 0.1
    turning = match(words, point + 1, 1, (2.5, 1.5, 0.0), free._replace(heading_penalty=1e9), noise, np.empty((21, 5)))
    assert turning.accepted == 0


def test_only_hits_are_matched_and_the_mount_counts():
    ranges = np.array([1.0, np.inf, np.nan, 2.0, 4.0, -np.inf, 0.0], dtype=np.float32)
    directions = np.array([[1.0] * 7, [0.0] * 7])
    directions[:, 3] = 0.0, 1.0
    points = np.zeros((2, 7), dtype=np.float32)
    count = project_hits(ranges, ScanGeometry(directions, 0.5, -0.25, 4.0, 0.25), points)
    assert count == 2
    np.testing.assert_allclose(points[:, :2], [[6.0, 2.0], [-1.0, 7.0]])

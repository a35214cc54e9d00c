import math

import numpy as np

from lidarnaut.envs.slam.scans import MAX_NEIGHBOURS, median_ranges

INCREMENT = 0.01


def expected(ranges, width):
    out = ranges.copy()
    for k, r in enumerate(ranges):
        if 0.0 < r < math.inf:
            half = min(int(0.5 * width / (r * INCREMENT)), MAX_NEIGHBOURS, k, len(ranges) - 1 - k)
            out[k] = np.nanmedian(ranges[k - half : k + half + 1])
    return out


def test_ranges_are_medians_over_a_width_at_the_wall():
    rng = np.random.default_rng(1)
    ranges = rng.uniform(0.05, 3.0, 400).astype(np.float32)
    ranges[rng.integers(400, size=60)] = np.nan
    ranges[rng.integers(400, size=60)] = np.inf
    np.testing.assert_array_equal(median_ranges(ranges, INCREMENT, 0.1), expected(ranges, 0.1))


def test_noise_falls_and_edges_stay():
    rng = np.random.default_rng(2)
    walls = np.repeat([1.0, 0.6], 200)
    smooth = median_ranges((walls + rng.normal(0.0, 0.03, 400)).astype(np.float32), INCREMENT, 0.1)
    assert np.std(smooth - walls) < 0.015
    assert np.std((smooth - walls)[8:-8]) < 0.02
    assert np.abs(smooth - walls)[8:-8].max() < 0.1  # no ranges between the two walls
    far = np.full(400, 9.0, dtype=np.float32)  # beams farther apart than the width
    far[7] = 6.0
    np.testing.assert_array_equal(median_ranges(far, INCREMENT, 0.1), far)

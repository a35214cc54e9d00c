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
    ranges = rng.uniform(0.05, 9.0, 400).astype(np.float32)
    ranges[rng.integers(400, size=60)] = np.nan
    ranges[rng.integers(400, size=60)] = np.inf
    np.testing.assert_array_equal(median_ranges(ranges, INCREMENT, 0.1), expected(ranges, 0.1))

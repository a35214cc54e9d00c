"""Films of environments: which moments they show."""

import types

import numpy as np
import pytest

from benchmarks.films import NUM_FRAMES, Film


@pytest.mark.parametrize("periods", [10, 47, 48, 49, 500, 5000])
def test_pictures_are_at_equal_intervals(periods):
    env = types.SimpleNamespace(control_period=0.1, time=0.0, on_period=None)
    env.render = lambda: np.full((2, 2, 3), env.time)
    env.unwrapped = env
    film = Film(env)
    for k in range(periods):
        env.time = 0.1 * k
        env.on_period(None)
    gaps = np.diff([frame[0, 0, 0] for frame in film.frames])
    np.testing.assert_allclose(gaps, gaps[0])
    assert min(periods, NUM_FRAMES // 2) <= len(film.frames) <= NUM_FRAMES

"""Films of environments: which moments they show."""

import numpy as np
import pytest

from benchmarks.films import NUM_FRAMES, Film
from envs.core import LidarEnv


@pytest.mark.parametrize("periods", [10, 47, 48, 49, 500, 5000])
def test_pictures_are_at_equal_intervals(periods):
    class Clock(LidarEnv):
        control_period, time = 0.1, 0.0

        def __init__(self):
            pass

        def render(self):
            return np.full((2, 2, 3), self.time)

    env = Clock()
    film = Film(env)
    for k in range(periods):
        env.time = 0.1 * k
        env.on_period(None)
    gaps = np.diff([frame[0, 0, 0] for frame in film.frames])
    np.testing.assert_allclose(gaps, gaps[0])
    assert min(periods, NUM_FRAMES // 2) <= len(film.frames) <= NUM_FRAMES

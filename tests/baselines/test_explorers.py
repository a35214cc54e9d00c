"""Explorers by name, and the one that draws its commands."""

import numpy as np
import pytest

from baselines import EXPLORERS, make_explorer
from baselines.explorer import to_action
from tests.baselines.maps import BURGER


def test_random_covers_the_action_space_and_follows_its_generator():
    explorer = make_explorer("random")
    draws = []
    for seed in (0, 0, 1):
        explorer.reset(BURGER, 0.1, np.random.default_rng(seed))
        draws.append(np.array([to_action(explorer.act(None, None), BURGER) for _ in range(2000)]))
    np.testing.assert_array_equal(draws[0], draws[1])
    assert not np.array_equal(draws[0], draws[2])
    assert draws[0].dtype == np.float32
    counts, _, _ = np.histogram2d(*draws[0].T, bins=4, range=[[-1, 1], [-1, 1]])
    assert counts.min() > 80
    assert counts.sum() == 2000


def test_unknown_names_are_answered_with_the_known_ones():
    with pytest.raises(ValueError, match=r"'teleporter'.*random, nearest, frontier"):
        make_explorer("teleporter")
    assert set(EXPLORERS) >= {"random", "nearest", "frontier"}

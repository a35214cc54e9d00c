"""Mapping, global localization and navigation, on a small world."""

import numpy as np
import pytest
from PIL import Image

from baselines.global_localization import main
from envs.worlds import load_map


def test_a_robot_maps_a_world_and_localizes_on_its_map(tmp_path):
    result = main("turtlebot3_world", tmp_path / "run", seed=0, goals=1, physics="kinematic")
    assert result.explored_fraction > 0.98
    grid = load_map(result.map_path)
    assert result.map_path.with_suffix(".pgm").exists()
    assert {-1, 0, 100} == set(np.unique(grid.data))
    assert result.goals == ("reached",)
    assert result.collisions == 0
    assert 0.0 < result.time_to_localize < 60.0
    assert result.error_when_localized < 0.3
    with Image.open(result.gif_path) as animation:
        assert animation.n_frames > 10
        first, last = (np.asarray(_frame(animation, k)) for k in (0, animation.n_frames - 1))
    # The particles cover the map at first, and a spot in the end.
    assert _area(first) > 5.0 * _area(last)


def _frame(animation, k):
    animation.seek(k)
    return animation.convert("RGB")


def _area(picture):
    """Pixels with about the colour of particles and of the estimated pose, without the legend."""
    from envs.rendering.style import ESTIMATED

    return np.count_nonzero(np.abs(picture[120:660].astype(int) - np.array(ESTIMATED)).sum(axis=-1) < 100)


def test_a_world_that_does_not_exist_is_named(tmp_path):
    with pytest.raises(ValueError, match="atlantis"):
        main(world="atlantis", out=tmp_path)

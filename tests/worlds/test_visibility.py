import math

import numpy as np
import pytest

from envs.geometry.lines import cell_along, longest_step
from envs.worlds import visibility
from envs.worlds.visibility import NUM_DIRECTIONS, visible_from


def walk(free, goals, reach):
    """Every line cell by cell: what `visible_from` says, without its short cuts."""
    visible = goals.copy()
    for row, col in np.argwhere(free & ~goals):
        for k in range(NUM_DIRECTIONS):
            slope = longest_step(2.399963229728653 * k)
            for step in range(1, int(reach / math.hypot(*slope)) + 1):
                i, j = cell_along(row, col, *slope, step)
                if not (0 <= i < free.shape[0] and 0 <= j < free.shape[1]) or not free[i, j]:
                    break
                if goals[i, j]:
                    visible[row, col] = True
                    break
    return visible


@pytest.mark.parametrize("seed", range(12))
def test_short_cuts_leave_out_no_line(seed):
    rng = np.random.default_rng(seed)
    shape = rng.integers(3, 25, 2)
    free = rng.random(shape) > rng.choice([0.02, 0.15, 0.4])
    goals = free & (rng.random(shape) < rng.choice([0.01, 0.1]))
    reach = rng.uniform(1.0, 30.0)
    np.testing.assert_array_equal(visible_from(free, goals, free, reach), walk(free, goals, reach))


def test_a_long_search_shows_its_progress(monkeypatch, capsys):
    free = np.ones((120, 40), dtype=bool)
    goals = np.zeros_like(free)
    goals[0, 0] = True
    visible_from(free, goals, free, 60.0, "hall")
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(visibility, "_DELAY", 0.0)
    visible_from(free, goals, free, 60.0, "hall")
    assert "explorable area of hall" in capsys.readouterr().err

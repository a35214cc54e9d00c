import math
import time

import numpy as np
import pytest
from numba import njit

from lidarnaut.envs.geometry.lines import cell_along, longest_step
from lidarnaut.envs.worlds import visibility
from lidarnaut.envs.worlds.visibility import NUM_DIRECTIONS, visible_from


@njit
def walk(free, goals, reach):
    """Trace every line cell by cell: `visible_from` without short cuts."""
    visible = goals.copy()
    for row, col in np.argwhere(free & ~goals):
        for k in range(NUM_DIRECTIONS):
            slope = longest_step(2.399963229728653 * k)
            for step in range(1, int(reach / math.hypot(slope[0], slope[1])) + 1):
                i, j = cell_along(row, col, slope[0], slope[1], step)
                if not (0 <= i < free.shape[0] and 0 <= j < free.shape[1]) or not free[i, j]:
                    break
                if goals[i, j]:
                    visible[row, col] = True
                    break
    return visible


def narrow_doors(height, width, *, room=60, corridor=5, door=3, pillars=0.0):
    """Free cells and goals: corridors along the rows, which are goals, with rooms above and below behind doors."""
    free = np.zeros((height, width), dtype=bool)
    goals = np.zeros_like(free)
    for top in range(2, height - corridor - 2, corridor + 2 * room + 6):
        free[top : top + corridor, 2:-2] = goals[top + 1 : top + corridor - 1, 3:-3] = True
        for left in range(2, width - room - 2, room + 2):
            middle = slice(left + room // 2, left + room // 2 + door)
            free[max(top - 2 - room, 1) : max(top - 2, 1), left : left + room] = True
            free[top + corridor + 2 : top + corridor + 2 + room, left : left + room] = True
            free[max(top - 2, 1) : top + corridor + 2, middle] = True
    free[[0, -1]] = free[:, [0, -1]] = False
    free &= goals | (np.random.default_rng(0).random(free.shape) >= pillars)
    return free, goals


@pytest.mark.parametrize("seed", range(12))
def test_short_cuts_leave_out_no_line_from_a_candidate(seed):
    rng = np.random.default_rng(seed)
    shape = rng.integers(3, 25, 2)
    free = rng.random(shape) > rng.choice([0.02, 0.15, 0.4])
    goals = free & (rng.random(shape) < rng.choice([0.01, 0.1]))
    reach = rng.uniform(1.0, 30.0)
    candidates = free & (rng.random(shape) < rng.choice([0.3, 1.0]))
    expected = goals | (candidates & walk(free, goals, reach))
    np.testing.assert_array_equal(visible_from(free, goals, candidates, reach), expected)


@pytest.mark.parametrize(
    ("shape", "room", "pillars", "reach"),
    [
        ((140, 261), 30, 0.03, 90.0),
        ((30, 700), 4, 0.0, 70.0),
        ((40, 90), 8, 0.0, 1e12),  # farther than the width of the world
    ],
)
def test_narrow_doors(shape, room, pillars, reach):
    free, goals = narrow_doors(*shape, room=room, pillars=pillars)
    for turned in range(4):
        case = np.rot90(free, turned).copy(), np.rot90(goals, turned).copy()
        expected = walk(*case, min(reach, 300.0))
        assert 0 < np.count_nonzero(expected & ~case[1]) < np.count_nonzero(case[0] & ~case[1])
        np.testing.assert_array_equal(visible_from(*case, case[0], reach), expected)


def test_rooms_behind_narrow_doors_take_seconds():
    """One search per cell took half a minute: nearly two million cells see no goal."""
    visible_from(*narrow_doors(30, 30), np.ones((30, 30), dtype=bool), 70.0)
    free, goals = narrow_doors(2500, 2500, pillars=0.01)
    began = time.process_time()
    visible = visible_from(free, goals, free, 70.0)
    assert time.process_time() - began < 5.0
    # Blocks of cells at any offset: visibility in a part of the raster depends only on cells within range.
    free, goals = (cells[1311:1611, 713:1313].copy() for cells in (free, goals))
    part = visible_from(free, goals, free, 70.0)
    np.testing.assert_array_equal(visible[1381:1541, 783:1243], part[70:-70, 70:-70])


def test_a_long_search_shows_its_progress(monkeypatch, capsys):
    free = np.ones((120, 40), dtype=bool)
    goals = np.zeros_like(free)
    goals[0, 0] = True
    visible_from(free, goals, free, 60.0, "hall")
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(visibility, "_PROGRESS_DELAY", 0.0)
    visible_from(free, goals, free, 60.0, "hall")
    assert "explorable area of hall" in capsys.readouterr().err

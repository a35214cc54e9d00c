import math

import numpy as np
import pytest
from numba import njit

from baselines import EXPLORERS
from baselines.episode import run_episode
from envs.core import LidarEnv
from envs.geometry import Pose2D
from envs.geometry.lines import cell_along, longest_step
from envs.robots import load_robot
from envs.tasks.explore import Explore
from envs.worlds import World, explorable, explorable_area
from envs.worlds.explorable import NUM_DIRECTIONS, visible_from


def squares(*sides, angle=0.0, spawn):
    """Walls along squares around the origin, turned by `angle`; `spawn` is the position along the x axis."""
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) / 2.0
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    walls = [np.hstack([side * corners, side * np.roll(corners, 1, axis=0)]) for side in sides]
    return World(
        name="squares",
        segments=(np.concatenate(walls).reshape(-1, 2) @ turn).reshape(-1, 4),
        circles=np.empty((0, 3)),
        spawns=(Pose2D(*(np.array([spawn, 0.0]) @ turn), 0.0),),
        bounds=(-max(sides), -max(sides), max(sides), max(sides)),
    )


def ring(width, length, angle=0.0):
    """A square ring of corridors, `length` along its middle."""
    return squares(length / 4 + width, length / 4 - width, angle=angle, spawn=length / 8)


@pytest.mark.parametrize("width", [0.5, 0.9])
@pytest.mark.parametrize("angle", [0.0, 0.2, math.pi / 8, 0.6, math.pi / 4])
def test_corridors_are_as_long_however_they_are_turned(width, angle):
    area = explorable_area(ring(width, 24.0, angle), load_robot("turtlebot3_burger"), 0.05)
    assert area.corridor_length == pytest.approx(24.0, rel=0.07)


def test_rooms_have_time_by_their_area_and_rings_of_narrow_corridors_by_their_length():
    burger = load_robot("turtlebot3_burger")
    room, narrow = (explorable_area(world, burger, 0.05) for world in (squares(10.0, spawn=1.0), ring(0.5, 60.0)))
    assert room.usual_time_limit(0.22) == 120.0 + 10.0 * round(0.2 * room.area / 0.22)
    assert narrow.usual_time_limit(0.22) == pytest.approx(60.0 + 60.0 / (0.4 * 0.22), rel=0.07)
    assert narrow.usual_time_limit(0.44) < narrow.usual_time_limit(0.22)


def test_there_is_time_for_a_ring_of_narrow_corridors():
    env = LidarEnv(Explore, world=ring(0.5, 60.0), physics="kinematic", slam="truth", start="spawn")
    assert run_episode(env, EXPLORERS["nearest"](), 0).explored_fraction > 0.95


@njit
def walk(free, goals, reach):
    """Every line cell by cell: what `visible_from` says, without its tables."""
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


@pytest.mark.parametrize("seed", range(12))
def test_a_cell_is_visible_where_one_of_its_lines_leads_to_a_goal(seed):
    rng = np.random.default_rng(seed)
    shape = rng.integers(3, 60, 2)
    free = rng.random(shape) > rng.choice([0.02, 0.15, 0.4])
    goals = free & (rng.random(shape) < rng.choice([0.01, 0.1]))
    candidates = free & (rng.random(shape) < rng.choice([0.5, 1.0]))
    reach = rng.uniform(1.0, 30.0)
    expected = goals | candidates & walk(free, goals, reach)
    np.testing.assert_array_equal(visible_from(free, goals, candidates, reach), expected)


def test_lidars_may_see_farther_than_the_world_is_wide():
    free = np.random.default_rng(0).random((40, 90)) > 0.05
    goals = np.zeros_like(free)
    goals[20, 10:20] = free[20, 10:20]
    np.testing.assert_array_equal(visible_from(free, goals, free, 1e12), walk(free, goals, 300.0))


def test_a_long_search_shows_its_progress(monkeypatch, capsys):
    free = np.ones((120, 40), dtype=bool)
    visible_from(free, free, free, 60.0, "hall")
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(explorable, "_DELAY", 0.0)
    visible_from(free, free, free, 60.0, "hall")
    assert "explorable area of hall" in capsys.readouterr().err

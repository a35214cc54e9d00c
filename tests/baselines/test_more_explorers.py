"""How the explorers beyond nearest and frontier choose, and that they get to know a small world."""

import gymnasium
import numpy as np
import pytest

import envs  # noqa: F401
from baselines import (
    ExploreLiteExplorer,
    ExploreLiteParams,
    GreedyGainExplorer,
    NextBestViewExplorer,
    NextBestViewParams,
    TourExplorer,
    TourParams,
    WallFollower,
    make_explorer,
)
from baselines.explorer import to_action
from baselines.goal_explorer import Goal
from baselines.visible_gain import visible_gains
from envs.geometry import OccupancyGrid
from tests.baselines.places import BURGER, belief_at, chosen_by, hall, observation_of, reading_of, survey_from

GOAL_EXPLORERS = [ExploreLiteExplorer, GreedyGainExplorer, NextBestViewExplorer, TourExplorer]


def corridor(*unknown, length=400):
    """A corridor of 2 m x 20 m, closed all around, with unknown cells in it.

    Args:
        unknown: (first column, last column) of each stretch of half its width that is unknown.
        length: columns.
    """
    data = np.full((44, length), 100, dtype=np.int8)
    data[2:42, 2 : length - 2] = 0
    for first, last in unknown:
        data[22:42, first : last + 1] = -1
    return OccupancyGrid(data, 0.05, (0.0, -1.1))


@pytest.mark.parametrize("name", ["explore_lite", "greedy_gain", "next_best_view", "tour"])
def test_goal_explorers_get_to_know_a_small_world(name):
    env = gymnasium.make(
        "lidarnaut/Explore-v0", world="turtlebot3_world", physics="kinematic", slam="tinyslam", start="spawn"
    ).unwrapped
    _, info = env.reset(seed=1)
    explorer = make_explorer(name)
    explorer.reset(env.robot, env.control_period, np.random.default_rng(1))
    while explorer.end_reason is None and "end_reason" not in info and info["time"] < 120.0:
        *_, info = env.step(to_action(explorer.act(env.reading, env.belief), env.robot))
    env.close()
    assert info["explored_fraction"] >= 0.97
    assert info["collisions"] == 0


@pytest.mark.parametrize("explorer_type", GOAL_EXPLORERS)
def test_a_closed_room_has_no_goals(explorer_type):
    grid = hall()
    grid.data[64:96, 28:30] = grid.data[40:120, 230:232] = 100
    assert chosen_by(explorer_type(), survey_from(5.0, 0.0, grid)) is None


@pytest.mark.parametrize("explorer_type", GOAL_EXPLORERS)
def test_a_frontier_that_cannot_be_got_to_is_given_up_in_the_end(explorer_type):
    explorer = explorer_type()
    explorer.reset(BURGER, 0.1, np.random.default_rng(0))
    survey = survey_from(5.0, 0.0)
    num_goals = 0
    while (goal := explorer._choose(survey)) is not None and num_goals < 200:
        explorer._fail(survey, goal)
        num_goals += 1
    assert 6 <= num_goals < 200


def test_visible_gain_equals_a_look_along_every_ray():
    rng = np.random.default_rng(0)
    data = rng.choice(np.array([-1, 0, 100], dtype=np.int8), p=[0.5, 0.45, 0.05], size=(40, 50))
    grid, reach = OccupancyGrid(data, 0.1, (0.0, 0.0)), 12
    places = np.array([[20, 25], [3, 4], [39, 49]])
    expected = []
    for row, col in places:
        seen = set()
        for angle in np.arange(76) * 2.0 * np.pi / 76:
            for step in range(1, reach + 1):
                r, c = int(np.floor(row + step * np.sin(angle) + 0.5)), int(np.floor(col + step * np.cos(angle) + 0.5))
                inside = 0 <= r < 40 and 0 <= c < 50
                if inside and data[r, c] == 100:
                    break
                if not inside or data[r, c] < 0:
                    seen.add((r, c))
        expected.append(0.01 * len(seen))
    np.testing.assert_allclose(visible_gains(grid, places, 1.2), expected)


def test_explore_lite_weighs_three_metres_against_nine_cells():
    # Frontiers of 60 cells 4 m to the left, and of more cells than that farther away to the right.
    def goal_x(right, more):
        grid = corridor((100, 119), (right, right + 19 + more))
        return chosen_by(ExploreLiteExplorer(), survey_from(10.0, -0.5, grid)).frontier[0]

    assert goal_x(280, 0) < 7.0
    assert goal_x(280, 40) > 13.0
    # Without gain the nearer one is better whatever its size.
    grid = corridor((100, 119), (280, 339))
    explorer = ExploreLiteExplorer(ExploreLiteParams(gain_scale=0.0))
    assert chosen_by(explorer, survey_from(10.0, -0.5, grid)).frontier[0] < 7.0


def test_explore_lite_asks_for_another_goal_every_third_look():
    explorer, survey = ExploreLiteExplorer(), survey_from(1.8, 0.0)
    best = chosen_by(explorer, survey)
    other = Goal(best.cell, (best.frontier[0], best.frontier[1] + 3.0))
    assert [explorer._better(survey, other) is None for _ in range(6)] == [True, True, False] * 2
    assert [explorer._better(survey, best) for _ in range(3)] == [None] * 3


def test_greedy_gain_goes_far_for_more_and_next_best_view_does_not():
    grid = corridor((180, 183), (300, 340))
    survey = survey_from(8.0, -0.5, grid)
    assert chosen_by(GreedyGainExplorer(), survey).frontier[0] > 14.0
    assert chosen_by(NextBestViewExplorer(), survey).frontier[0] < 10.0
    assert chosen_by(NextBestViewExplorer(NextBestViewParams(discount=0.0)), survey).frontier[0] > 14.0


def test_a_tour_finishes_what_is_near_before_it_leaves_for_good():
    # 1.5 m to the left lies a dead end, 1.2 m to the right the way on: nearest goes right, and must come back.
    grid = corridor((160, 169), (225, 230), (300, 320))
    survey = survey_from(10.0, -0.5, grid)
    assert chosen_by(make_explorer("nearest"), survey).frontier[0] > 11.0
    assert chosen_by(TourExplorer(TourParams(max_stops=16)), survey).frontier[0] < 9.0


def test_a_tour_is_kept_to_unless_another_one_is_clearly_shorter():
    grid = corridor((160, 169), (231, 240))
    explorer = TourExplorer()
    first = chosen_by(explorer, survey_from(10.0, -0.5, grid))
    assert first.frontier[0] < 9.0
    # A step to the other side makes the other order a little shorter, and a longer one clearly.
    assert explorer._better(survey_from(10.2, -0.5, grid), first) is None
    fresh = chosen_by(TourExplorer(), survey_from(10.2, -0.5, grid))
    assert fresh.frontier[0] > 11.0
    assert explorer._better(survey_from(11.2, -0.5, grid), first).frontier[0] > 11.0


def test_a_goal_is_changed_on_the_way():
    explorer = TourExplorer()
    explorer.reset(BURGER, 0.1, np.random.default_rng(0))
    grid = corridor((160, 169), (231, 240))
    for _ in range(12):
        explorer._act(observation_of(), belief_at(10.0, -0.5, grid))
    assert explorer.plan[-1, 0] < 9.0
    for _ in range(12):
        explorer._act(observation_of(), belief_at(11.2, -0.5, grid))
    assert explorer.plan[-1, 0] > 11.0


@pytest.mark.parametrize(
    ("params_type", "wrong"),
    [
        (TourParams, {"max_stops": 0}),
        (TourParams, {"sizes": ()}),
        (TourParams, {"hysteresis": -1.0}),
        (ExploreLiteParams, {"planner_frequency": 0.0}),
        (ExploreLiteParams, {"min_cells": 0}),
        (NextBestViewParams, {"num_samples": 0}),
        (NextBestViewParams, {"discount": -0.1}),
    ],
)
def test_params_refuse_nonsense(params_type, wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        params_type(**wrong)


def reading_of_walls(*, right=np.inf, ahead=np.inf, yaw_rate=0.0):
    """What a burger sees between a wall parallel to its way and one across it [m]."""
    angles = BURGER.lidar.angles
    with np.errstate(divide="ignore"):
        to_right = np.where(np.sin(angles) < 0, right / -np.sin(angles), np.inf)
        to_front = np.where(np.cos(angles) > 0, ahead / np.cos(angles), np.inf)
    ranges = np.fmin(to_right, to_front)
    return reading_of(ranges=np.where(ranges > BURGER.lidar.range_max, np.inf, ranges), yaw_rate=yaw_rate)


def wall_follower(*, following):
    explorer = WallFollower()
    explorer.reset(BURGER, 0.1, np.random.default_rng(0))
    if following:
        explorer.act(reading_of_walls(ahead=0.4, right=0.25), None)
    return explorer


def test_the_wall_follower_drives_straight_on_to_a_wall_and_turns_left_there():
    assert wall_follower(following=False).act(reading_of_walls(), None).w == 0.0
    assert wall_follower(following=False).act(reading_of_walls(ahead=0.3, right=0.25), None).w > 0.0


def test_the_wall_follower_stays_beside_its_wall_and_turns_right_where_it_ends():
    explorer = wall_follower(following=True)
    along = explorer.act(reading_of_walls(right=0.3), None)
    assert along.v > 0.3 * BURGER.max_v
    assert abs(along.w) < 0.2 * BURGER.max_w
    assert explorer.act(reading_of_walls(right=1.5), None).w < 0.0


def test_the_wall_follower_leaves_a_pillar_that_it_has_been_round():
    explorer = wall_follower(following=True)
    turn, period = 0.3 * BURGER.max_w, 0.1
    steps = 0
    while explorer.act(reading_of_walls(right=1.5, yaw_rate=-turn), None).w <= 0.0:
        steps += 1
        assert steps < 200
    # It turns away to the left when it leaves.
    assert steps == pytest.approx(2.0 * np.pi / (turn * period), abs=2)

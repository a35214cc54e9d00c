"""Seed 3's explorer, item by item."""

import logging

import numpy as np
import pytest

from baselines import FrontierExplorer, FrontierParams
from baselines.frontier import _information_gain, _is_clear
from baselines.goal_explorer import Goal
from envs.geometry import OccupancyGrid
from tests.baselines.places import BURGER, belief_at, chosen_by, hall, observation_of, survey_from

WIDE, SMALL = (10.1, 0.0), (-0.1, 0.0)
"""Where the hall's openings are."""


def fresh_explorer(**params):
    explorer = FrontierExplorer(FrontierParams(**params))
    explorer.reset(BURGER, 0.1, np.random.default_rng(0))
    return explorer


def test_params_are_those_of_the_seed():
    params = FrontierParams()
    assert (params.cluster_tolerance, params.min_frontier_size, params.min_frontier_size_final) == (0.5, 8, 3)
    assert (params.obstacle_clearance, params.information_gain_radius, params.min_goal_distance) == (0.5, 2.0, 1.2)
    assert (params.adaptive_threshold, params.blacklist_radius, params.max_blacklist_size) == (0.7, 1.2, 25)


@pytest.mark.parametrize(
    "wrong",
    [
        {"cluster_tolerance": 0.0},
        {"min_frontier_size_final": 9},
        {"adaptive_threshold": 1.5},
        {"obstacle_above": 100},
        {"blacklist_radius": -1.0},
        {"max_blacklist_size": 0},
    ],
)
def test_params_refuse_nonsense(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        FrontierParams(**wrong)


@pytest.mark.parametrize(("num_free", "counts"), [(6900, False), (7100, True)])
def test_small_frontiers_count_once_most_is_explored(num_free, counts):
    # Of 100 x 100 cells as many are free as told, the others occupied but for an unknown one: a frontier of 5 cells.
    data = np.full(10000, 100, dtype=np.int8)
    data[:num_free] = 0
    data = data.reshape(100, 100)
    data[0, 50] = -1
    survey = survey_from(1.0, 1.0, OccupancyGrid(data, 0.05, (0.0, 0.0)))
    cells = np.argwhere(survey.frontier)
    assert len(cells) == 5
    assert (len(fresh_explorer()._clusters(survey, cells, FrontierParams())) == 1) == counts


def test_clearance_is_kept_to_the_centimetre_of_a_cell():
    survey = survey_from(5.0, 0.0)
    # The lower wall's upper cell has its centre at y = -3.025.
    points = np.array([[5.0, -2.975 + 0.05 * k] for k in range(15)])
    clear = _is_clear(survey, points, FrontierParams())
    np.testing.assert_array_equal(clear, points[:, 1] + 3.025 > 0.501)


@pytest.mark.parametrize(("side", "factor"), [(10.0, 0.5 * 2.0**0.5), (40.0, 2.0)])
def test_the_gain_counts_a_disc_that_grows_with_the_map(side, factor):
    data = np.full((round(side / 0.1),) * 2, -1, dtype=np.int8)
    # Known corners keep the map from being cropped.
    data[0, 0] = data[-1, -1] = 0
    survey = survey_from(0.05, 0.05, OccupancyGrid(data, 0.1, (0.0, 0.0)))
    middle = np.array([side / 2, side / 2])
    cells = {scale: _information_gain(survey, middle, FrontierParams(scale_radius_with_map=scale)) for scale in (0, 1)}
    assert cells[0] * 0.01 == pytest.approx(np.pi * 2.0**2, rel=0.02)
    assert cells[1] / cells[0] == pytest.approx(factor**2, rel=0.03)


def test_goals_nearer_than_the_least_distance_are_left_out():
    # The small opening is 0.8 m away: its utility is the greater, but it comes only when the filters are relaxed.
    survey = survey_from(0.7, 0.0)
    assert chosen_by(FrontierExplorer(), survey).frontier[0] > 10.0
    assert chosen_by(FrontierExplorer(FrontierParams(min_goal_distance=0.0)), survey).frontier[0] < 0.0


def test_no_goal_is_sent_that_no_path_leads_to():
    grid = hall()
    assert chosen_by(FrontierExplorer(), survey_from(5.0, 0.0, grid)).frontier[0] > 10.0
    grid.data[20:140, 180:182] = 100
    assert chosen_by(FrontierExplorer(), survey_from(5.0, 0.0, grid)).frontier[0] < 0.0


def test_the_blacklist_covers_its_radius_and_forgets_the_oldest():
    explorer, survey = fresh_explorer(), survey_from(5.0, 0.0)
    for k in range(30):
        explorer._fail(survey, Goal((0, 0), (3.0 * k, 0.0)))
    assert explorer.status.blacklist_size == 25
    points = np.array([[12.0, 0.0], [15.0, 0.0], [16.19, 0.0], [16.21, 0.0], [87.0, 1.1]])
    np.testing.assert_array_equal(explorer._is_blacklisted(points, 1.2), [False, True, True, False, True])


def test_a_robot_that_dithers_on_the_spot_drops_its_goal_for_another():
    explorer, observation = fresh_explorer(), observation_of()
    explorer._act(observation, belief_at(5.0, 0.0))
    first = explorer.status.goal
    assert first[0] > 10.0
    steps = 0
    while explorer.status.goal == first:
        # To and fro by 0.2 m: that is moving, but leads nowhere.
        explorer._act(observation, belief_at(5.0 + 0.2 * (steps // 20 % 2), 0.0))
        steps += 1
        assert steps < 400
    assert 295 <= steps <= 330
    assert explorer.status.goal[0] < 0.0
    assert explorer.status.blacklist_size == 1
    assert explorer.end_reason is None
    # The way there is the new goal's.
    assert explorer.plan[-1, 0] < 0.5


def test_status_and_log_tell_the_progress(caplog):
    explorer = fresh_explorer()
    assert explorer.status.goal is None
    with caplog.at_level(logging.INFO, logger="baselines.frontier"):
        explorer._act(observation_of(), belief_at(5.0, 0.0))
    status, data = explorer.status, survey_from(5.0, 0.0).grid.data
    assert status.explored_share == pytest.approx((data == 0).mean())
    assert status.relaxation == 0
    np.testing.assert_allclose(status.candidates, [WIDE, SMALL], atol=0.06)
    assert np.hypot(*np.subtract(status.goal, WIDE)) < 0.1
    assert f"{100 * status.explored_share:.0f} % explored, goal (10." in caplog.text
    assert "2 candidates at relaxation 0, 0 blacklisted" in caplog.text


def test_a_robot_walled_in_by_its_own_map_says_that_it_is_stuck():
    grid = hall()
    rows, cols = np.ogrid[:160, :260]
    grid.data[(rows - 80) ** 2 + (cols - 130) ** 2 <= 8**2] = 100
    explorer = fresh_explorer()
    for _ in range(200):
        explorer._act(observation_of(), belief_at(5.0, 0.0, grid))
        if explorer.end_reason is not None:
            break
    assert explorer.end_reason == "stuck"

import logging
from dataclasses import replace

import numpy as np
import pytest

from lidarnaut import make_policy
from lidarnaut.baselines.frontier.utility import FrontierExplorer, FrontierParams, cluster, is_clear
from lidarnaut.envs.geometry import OccupancyGrid
from lidarnaut.envs.navigation import DwbParams, crop_to_known
from tests.baselines.maps import BURGER, belief_at, candidates_from, first_choice, hall, reading_of


def rule_at_rest(**params):
    rule = FrontierExplorer(FrontierParams(**params)).rule
    rule.reset(BURGER, np.random.default_rng(0))
    return rule


def test_clusters_are_dense_groups_of_candidates_cells():
    candidates = candidates_from(5.0, 0.0)
    cells, owners, labels = cluster(candidates, 0.5, 8)
    assert labels.max() == 1
    for label, opening in ((labels[0], cells[0]), (labels[-1], cells[-1])):
        assert (np.abs(cells[labels == label][:, 0] - opening[0]) < 1.0).all()
    assert all(len(candidates.cells[k]) == np.count_nonzero(owners == k) for k in range(len(candidates)))
    assert (cluster(candidates, 0.5, 100)[2] == -1).all()


def test_clearance_is_kept_to_the_centimetre_of_a_cell():
    # The upper cell of the lower wall has its centre at y = -3.025.
    points = np.array([[5.0, -2.975 + 0.05 * k] for k in range(15)])
    clear = is_clear(crop_to_known(hall()), points, FrontierParams())
    np.testing.assert_array_equal(clear, points[:, 1] + 3.025 > 0.501)


@pytest.mark.parametrize(("side", "factor"), [(10.0, 0.5 * 2.0**0.5), (40.0, 2.0)])
def test_the_gain_counts_a_disc_that_grows_with_the_map(side, factor):
    grid = OccupancyGrid(np.full((round(side / 0.1),) * 2, -1, dtype=np.int8), 0.1, (0.0, 0.0))
    radii = [FrontierParams(scale_radius_with_map=scale).gain_radius(grid) for scale in (False, True)]
    assert radii == pytest.approx([2.0, 2.0 * factor])


def test_goals_nearer_than_the_least_distance_are_left_out():
    # The small opening is 0.8 m away: its utility is greater, but only the relaxed filters accept it.
    assert first_choice(FrontierExplorer(), 0.7, 0.0)[0] > 10.0
    assert first_choice(FrontierExplorer(FrontierParams(min_goal_distance=0.0)), 0.7, 0.0)[0] < 0.0


def test_filters_are_relaxed_before_exploration_ends():
    # A corridor of 0.9 m: every frontier is closer to walls than the clearance, and closer than the minimum distance.
    data = np.full((60, 60), -1, dtype=np.int8)
    data[20:40, 20:38] = 0
    data[18:20, 20:38] = data[40:42, 20:38] = 100
    grid, rule = OccupancyGrid(data, 0.05, (0.0, 0.0)), rule_at_rest()
    rule(candidates_from(1.45, 1.5, grid), belief_at(1.45, 1.5, grid))
    assert rule.relaxation >= 3


def test_what_failed_is_blacklisted_until_too_much_is():
    rule, candidates, belief = rule_at_rest(), candidates_from(5.0, 0.0), belief_at(5.0, 0.0)
    failed = replace(candidates, last_failed=True)
    assert candidates["frontier"][rule(candidates, belief).argmax()][0] > 10.0
    assert candidates["frontier"][rule(failed, belief).argmax()][0] < 0.0
    assert len(rule.blacklist) == 1
    # Two blacklisted goals are more than half: the list is shortened, and the older one is free again.
    assert candidates["frontier"][rule(failed, belief).argmax()][0] > 10.0


def test_a_robot_that_gets_nowhere_drops_its_goal_for_another():
    explorer = FrontierExplorer()
    explorer.reset(BURGER, 0.1, np.random.default_rng(0))
    explorer.act(reading_of(), belief_at(5.0, 0.0))
    first, steps, grid = explorer.rule.goal, 0, hall()
    assert first[0] > 10.0
    while explorer.rule.goal == first:
        # The robot moves 0.2 m back and forth without progress.
        steps += 1
        explorer.act(reading_of(time=0.1 * steps), belief_at(5.0 + 0.2 * (steps // 20 % 2), 0.0, grid))
        assert steps < 400
    assert explorer.rule.goal[0] < 0.0
    assert len(explorer.rule.blacklist) == 1
    assert explorer.end_reason is None
    assert explorer.plan[-1, 0] < 0.5


def test_the_log_tells_the_progress(caplog):
    rule, candidates = rule_at_rest(), candidates_from(5.0, 0.0)
    with caplog.at_level(logging.INFO, logger="lidarnaut.baselines.frontier"):
        rule(candidates, belief_at(5.0, 0.0))
    share = (crop_to_known(candidates.costmap.grid).data == 0).mean()
    assert np.hypot(*np.subtract(rule.goal, (10.1, 0.0))) < 0.15
    assert f"{100 * share:.0f} % explored, goal (10." in caplog.text
    assert "2 candidates at relaxation 0, 0 blacklisted" in caplog.text


def test_a_robot_walled_in_by_its_own_map_says_that_it_is_stuck():
    grid, explorer = hall(), FrontierExplorer()
    rows, cols = np.ogrid[:160, :260]
    grid.data[(rows - 80) ** 2 + (cols - 130) ** 2 <= 8**2] = 100
    explorer.reset(BURGER, 0.1, np.random.default_rng(0))
    for k in range(200):
        if explorer.end_reason is None:
            explorer.act(reading_of(time=0.1 * k), belief_at(5.0, 0.0, grid))
    assert explorer.end_reason == "stuck"


def test_published_values_reach_planning_driving_and_dwb():
    explorer = make_policy("frontier:published")
    dwb, limits, rule = explorer.dwb, explorer.params, explorer.rule._params
    assert (dwb.max_vel_x, dwb.max_vel_theta, dwb.acc_lim_x, dwb.sim_time, dwb.width) == (0.78, 2.0, 4.0, 2.5, 10.0)
    assert (dwb.inflation_radius, limits.stuck_time, limits.stuck_distance) == (0.6, 30.0, 0.5)
    assert dwb.xy_goal_tolerance == limits.max_goal_tolerance == 0.3
    assert (rule.cluster_tolerance, rule.min_frontier_size, rule.blacklist_radius) == (0.5, 8, 1.2)
    assert FrontierExplorer().dwb is None


def test_dwb_drives_to_the_frontier_with_its_parameters():
    speeds = []
    for params in (None, DwbParams(max_vel_x=0.1), DwbParams()):
        explorer = FrontierExplorer(dwb=params)
        explorer.reset(BURGER, 0.1, np.random.default_rng(0))
        for k in range(12):
            twist = explorer.act(reading_of(time=0.1 * k), belief_at(5.0, 0.0))
        speeds.append(twist.v)
    assert 0.05 < speeds[1] <= 0.1 < speeds[2]
    assert "goal [10." in explorer.status
    assert "0 blacklisted" in explorer.status

"""What the goal explorers share: keeping to goals, and giving up frontiers that nothing lies behind."""

import numpy as np

from baselines import NearestExplorer
from baselines.candidates import goal_for
from baselines.goal_explorer import Goal, GoalExplorer
from baselines.navigator import Status
from envs.geometry import OccupancyGrid
from envs.navigation import frontier_clusters
from tests.baselines.places import BURGER, belief_at, observation_of, survey_from


class Undecided(GoalExplorer):
    """Always prefers the other one of the hall's two openings."""

    def _choose(self, survey):
        return self._towards(survey, 0)

    def _better(self, survey, goal):
        return self._towards(survey, 1 if goal.frontier[0] < 5.0 else 0)

    def _towards(self, survey, which):
        clusters = sorted(frontier_clusters(survey.frontier), key=lambda cells: cells[0, 1])
        return goal_for(survey, survey.field, clusters[-which])


def test_a_robot_that_changes_its_mind_still_notices_that_it_is_stuck():
    explorer = Undecided()
    explorer.reset(BURGER, 0.1, np.random.default_rng(0))
    for _ in range(350):
        explorer._act(observation_of(), belief_at(5.0, 0.0))
    assert len(explorer._failures)


def test_a_goal_that_was_turned_away_from_is_not_turned_to_again_on_the_way():
    explorer = Undecided()
    explorer.reset(BURGER, 0.1, np.random.default_rng(0))
    ends = []
    for step in range(60):
        # Drives somewhere all the time, so that it is never stuck.
        explorer._act(observation_of(), belief_at(5.0 + 2.0 * np.sin(0.05 * step), 0.0))
        ends.append(explorer._goal.frontier[0])
    assert np.count_nonzero(np.abs(np.diff(ends)) > 5.0) == 1


def explorer_at_rest():
    explorer = NearestExplorer()
    explorer.reset(BURGER, 0.1, np.random.default_rng(0))
    return explorer


def two_chambers():
    """Two rooms of 4 m x 3 m side by side, a wall between them, and an unknown spot on either side of it."""
    data = np.full((64, 164), 100, dtype=np.int8)
    data[2:62, 2:81] = data[2:62, 83:162] = 0
    data[30:34, 77:81] = data[30:34, 83:87] = -1
    return OccupancyGrid(data, 0.05, (0.0, 0.0))


def test_only_what_is_in_sight_is_given_up_with_a_goal():
    explorer, grid = explorer_at_rest(), two_chambers()
    # The robot stands 0.3 m beside the left spot, 0.6 m from the right one.
    survey = survey_from(3.6, 1.6, grid)
    left, right = (survey.frontier[:, part].copy() for part in (slice(0, 81), slice(83, 164)))
    goal = Goal((32, 72), (3.7, 1.6))
    explorer._give_up_in_sight(survey, goal, explorer._frontier_near(survey, goal.frontier, 0.4))
    assert left.any()
    assert not survey.frontier[:, :81].any()
    np.testing.assert_array_equal(survey.frontier[:, 83:], right)
    # Nor does it come back with the next look at the same map.
    again = explorer._survey(explorer._navigator, belief_at(3.6, 1.6, grid), 0)
    assert not again.frontier[:, :80].any()


def test_a_goal_that_showed_what_it_was_for_gives_nothing_up():
    explorer, grid = explorer_at_rest(), two_chambers()
    explorer._goal = Goal((20, 40), (2.0, 1.0))
    explorer._navigator.status = Status.REACHED
    explorer._consider(explorer._navigator, belief_at(3.5, 1.6, grid))
    assert len(explorer._given_up) == 0
    assert explorer._goal.frontier[0] > 3.5


def spotted(sizes):
    """A closed hall with unknown spots of so many cells' width along its middle."""
    data = np.full((84, 404), 100, dtype=np.int8)
    data[2:82, 2:402] = 0
    for k, size in enumerate(sizes):
        data[40 : 40 + size, 60 + 60 * k : 60 + 60 * k + size] = -1
    return OccupancyGrid(data, 0.05, (0.0, 0.0))


def test_goals_in_vain_raise_what_counts_as_a_frontier_until_one_shows_enough():
    explorer, grid = explorer_at_rest(), spotted([1, 2, 4, 12])
    belief = belief_at(1.0, 2.0, grid)

    def num_frontiers():
        return len(frontier_clusters(explorer._survey(explorer._navigator, belief, 0).frontier))

    explorer._weigh_gain(survey_from(1.0, 2.0, grid))
    assert num_frontiers() == 4
    seen = []
    for k in range(12):
        explorer._fail(survey_from(1.0, 2.0, grid), Goal((0, 0), (100.0 + k, 0.0)))
        explorer._weigh_gain(survey_from(1.0, 2.0, grid))
        seen.append(num_frontiers())
    assert seen == sorted(seen, reverse=True)
    assert seen[0] == 4
    assert seen[-1] == 1
    # A square of four of the robot's radii has come to light.
    width = round(4.0 * BURGER.radius / 0.05) + 1
    more = grid.data.copy()
    more[10 : 10 + width, 10 : 10 + width] = -1
    explorer._weigh_gain(survey_from(1.0, 2.0, OccupancyGrid(more, 0.05, (0.0, 0.0))))
    assert num_frontiers() == 1
    explorer._weigh_gain(survey_from(1.0, 2.0, grid))
    assert num_frontiers() == 4

import numpy as np
import pytest

from lidarnaut.baselines.episode import run_episode
from lidarnaut.baselines.frontier.expected_map import Prediction, expect_map
from lidarnaut.baselines.frontier.expected_tour import ExpectedTour, ExpectedTourParams
from lidarnaut.baselines.frontier.pursuit_explorer import PursuitDriving
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.tasks.explore import Explore
from tests.baselines.maps import BURGER, belief_at, candidates_from


def predict_boxes(*boxes, angle=0.0):
    """Return a prediction of floor inside boxes (x_min, y_min, x_max, y_max), map frame."""

    def predict(grid):
        corner, side = np.array([-20.0, -20.0]), 0.2
        cols, rows = np.meshgrid(np.arange(250), np.arange(250))
        u, v = corner[0] + (cols + 0.5) * side, corner[1] + (rows + 0.5) * side
        x, y = np.cos(angle) * u - np.sin(angle) * v, np.sin(angle) * u + np.cos(angle) * v
        inside = np.zeros(u.shape, dtype=bool)
        for left, bottom, right, top in boxes:
            inside |= (x >= left) & (x <= right) & (y >= bottom) & (y <= top)
        return Prediction(np.where(inside, np.float32(0.9), np.float32(0.1)), angle, tuple(corner.tolist()), side)

    return predict


ALL = -20.0, -20.0, 30.0, 30.0


@pytest.mark.parametrize("angle", [0.0, 0.6])
def test_expected_floor_is_near_known_floor_and_connected_to_it(angle):
    candidates = candidates_from(4.0, 0.0)  # a hall with openings at x = -0.1 and x = 10.1
    expected = expect_map(candidates.costmap, predict_boxes(ALL, angle=angle)(None), reach=2.0, threshold=0.5)
    rows, cols = np.nonzero(expected.expected)
    x = expected.origin[0] + (cols + 0.5) * expected.side
    assert -0.9 < x.min() < -0.5  # there is a wall
    assert 11.5 < x.max() < 12.5
    assert ((x < 0.1) | (x > 9.0)).all()  # also around the corner
    assert expected.clear[rows, cols].all()
    assert np.isin(expected.expected[rows, cols], np.float32(0.9)).all()
    # Not through walls: beside the hall, nothing is expected without a prediction behind its openings.
    beside = expect_map(candidates.costmap, predict_boxes((2.0, 2.0, 8.0, 12.0))(None), reach=2.0, threshold=0.5)
    assert not beside.expected.any()
    assert not expect_map(candidates.costmap, predict_boxes(ALL)(None), reach=2.0, threshold=0.95).expected.any()


def chosen_side(*boxes, x=5.0, **params):
    candidates, belief = candidates_from(x, 0.0), belief_at(x, 0.0)
    rule = ExpectedTour(predict_boxes(*boxes), ExpectedTourParams(**params))
    rule.reset(BURGER, np.random.default_rng(0))
    scores = rule(candidates, belief)
    return candidates["frontier"][scores.argmax()][0] > 5.0


def test_a_closet_is_taken_along_before_the_way_to_the_other_side():
    """From x = 4 the left opening is nearer, from x = 6 the right one: the tour begins at the nearer end."""
    both = (-1.5, -5.0, 0.0, 5.0), (10.0, -5.0, 11.5, 5.0)
    assert not chosen_side(*both, x=4.0)
    assert chosen_side(*both, x=6.0)


def test_a_frontier_with_nothing_behind_it_is_left():
    """The tour leads only to the opening behind which floor is expected, although the other one is nearer."""
    assert chosen_side((10.0, -5.0, 13.0, 5.0), x=4.0, num_best=2)
    assert not chosen_side((-3.0, -5.0, 0.0, 5.0), x=6.0, num_best=2)


def test_without_expected_floor_the_nearest_frontier_is_chosen():
    assert not chosen_side(x=4.0)
    assert chosen_side(x=6.0)


def test_robots_that_expect_floor_everywhere_explore_a_world_with_one_seed_one_episode():
    def explore():
        env = LidarEnv(Explore, world="rooms", world_size=(8.0, 8.0), physics="kinematic", target_coverage=0.6)
        episode = run_episode(env, PursuitDriving(ExpectedTour(predict_boxes(ALL)), max_time=1.0), 2)
        env.close()
        return episode

    first, again = explore(), explore()
    assert first.explored_fraction >= 0.6
    assert first.duration == again.duration

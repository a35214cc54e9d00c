import math
from dataclasses import asdict

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.navigation import DwbParams, DwbPlanner
from lidarnaut.envs.navigation.controllers import critics
from lidarnaut.envs.navigation.controllers.regulated_pursuit import as_record
from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.simulation import Twist
from tests.navigation.driving import NOTHING, PERIOD, drive, path_through
from tests.rooms import BURGER, ORIGIN

SIDE = 41
MIDDLE = SIDE // 2
AWAY = critics.Ending(False, 0.0, True)
NOBODY = np.empty((0, 5))


def numbers_of(acc=1e9):
    params = DwbParams(acc_lim_x=acc, acc_lim_theta=acc, inflation_radius=1.0, sim_time=1.0, linear_granularity=0.005)
    return as_record(asdict(params) | {"angular_granularity": 0.0025})[0]


STANDING = (0.0, 0.0)
STOPPED = Twist(0.0, 0.0)


def planner_to(x, robot=BURGER, params=DwbParams(), **ending):  # noqa: B008
    planner = DwbPlanner(robot, PERIOD, params)
    planner.set_path(path_through([0.0, 0.0], [x, 0.0]), **ending)
    return planner


def test_trajectories_are_arcs_once_the_speed_is_reached():
    poses = np.empty((1000, 3))
    num = critics.roll_out(0.5, 1.0, (0.5, 1.0), numbers_of(), poses)
    x, y, theta = poses[num - 1]
    assert theta == pytest.approx(1.0)
    assert (x, y) == pytest.approx((0.5 * math.sin(1.0), 0.5 * (1.0 - math.cos(1.0))), abs=1e-4)
    num = critics.roll_out(0.4, 0.0, STANDING, numbers_of(acc=0.5), poses)
    # 0.8 s to reach 0.4 m/s, then 0.2 s at this speed.
    assert poses[num - 1, 0] == pytest.approx(0.5 * 0.5 * 0.8**2 + 0.4 * 0.2, abs=4e-3)


def rasters(costs=None, path_row=MIDDLE, goal=(MIDDLE, SIDE - 1)):
    costs = np.zeros((SIDE, SIDE), dtype=np.uint8) if costs is None else costs
    to_path, to_goal = (np.empty((SIDE, SIDE), dtype=np.int32) for _ in range(2))
    critics.spread(costs, to_path, path_row * SIDE + np.arange(SIDE))
    critics.spread(costs, to_goal, np.array([goal[0] * SIDE + goal[1]]))
    return costs, to_path, to_goal


def scores_of(
    twists, *, costs=None, squared=None, banned=(False,) * 4, now=STANDING, ending=AWAY, people=NOBODY, **kwargs
):
    costs, to_path, to_goal = rasters(costs, **kwargs)
    squared = np.full((SIDE, SIDE), 100, dtype=np.uint16) if squared is None else squared
    scores = np.empty((len(twists), 7))
    twists = np.array(twists, dtype=np.float64)
    steps = np.stack([to_path, to_goal, to_goal])
    maps = critics.Rasters(costs, squared, steps)
    critics.judge(twists, banned, now, numbers_of(), ending, maps, people, 0.2, scores)
    return scores


def test_steps_spread_around_what_is_touched():
    rng = np.random.default_rng(0)
    costs = np.where(rng.random((SIDE, SIDE)) < 0.35, 253, 0).astype(np.uint8)
    seed = (5, 7)
    costs[seed] = 0
    _, _, found = rasters(costs, goal=seed)
    expected = np.full((SIDE, SIDE), SIDE * SIDE + 1)
    reached = np.zeros((SIDE, SIDE), dtype=bool)
    reached[seed] = True
    expected[seed] = 0
    for step in range(1, SIDE * SIDE):
        grown = binary_dilation(reached) & (costs == 0)
        if (grown == reached).all():
            break
        expected[grown & ~reached] = step
        reached = grown
    expected[binary_dilation(reached) & (costs == 253)] = SIDE * SIDE
    np.testing.assert_array_equal(found, expected)


def test_path_and_goal_critics_count_cells():
    scores = scores_of([(0.5, 0.0), (0.25, 0.0)], path_row=MIDDLE + 3, now=(0.5, 0.0))
    assert scores[0, critics.PATH_DIST] == 3
    assert scores[0, critics.GOAL_DIST] == 10
    assert scores[1, critics.GOAL_DIST] > scores[0, critics.GOAL_DIST]
    # The point in front shows the direction of the coming turn.
    left, right = scores_of([(0.0, 1.0), (0.0, -1.0)], path_row=MIDDLE + 3)[:, critics.PATH_ALIGN]
    assert left < right


WALL, SQUARED = np.zeros((SIDE, SIDE), np.uint8), np.tile((np.arange(SIDE)[::-1] ** 2).astype(np.uint16), (SIDE, 1))
WALL[:, MIDDLE + 4 :], WALL[:, MIDDLE + 2 : MIDDLE + 4] = 253, 120
TOUCHED = np.where(SQUARED <= (MIDDLE + 1) ** 2, 253, 0).astype(np.uint8)
CROSSING = np.array([[0.4, -0.8, 0.0, 0.8, 0.1]])
"""Person who crosses the path at x = 0.4 m: only a fast trajectory is there at this time."""


@pytest.mark.parametrize(
    ("twists", "situation", "costs"),
    [
        ([(0.1, 0.5), (0.1, -0.5)], {"banned": (False, False, True, False)}, [0, math.nan]),
        ([(0.1, 0.5), (0.1, -0.5)], {"banned": (False, False, False, True)}, [math.nan, 0]),
        ([(0.15, 0), (0.3, 0)], {"costs": WALL, "now": (0.2, 0.0), "goal": (MIDDLE, MIDDLE)}, [120, math.nan]),
        # A robot that touches something may leave, but not approach.
        ([(0.2, 0), (0, 0.5), (-0.2, 0)], {"costs": TOUCHED, "squared": SQUARED}, [math.nan, 253, 0]),
        ([(0.4, 0), (0.05, 0)], {"people": CROSSING, "now": (0.4, 0.0)}, [math.nan, 0]),
        ([(0.4, 0)], {"people": CROSSING * (1, 1, 0, 0, 1), "now": (0.4, 0.0)}, [0]),
    ],
)
def test_twists_are_rejected_by_bans_contacts_and_people(twists, situation, costs):
    np.testing.assert_array_equal(scores_of(twists, **situation)[:, critics.BASE_OBSTACLE], costs)


def test_near_the_goal_the_robot_stops_and_then_turns():
    ending = critics.Ending(True, 1.0, True)
    moving = scores_of([(0.5, 0.0), (0.3, 0.0), (0.0, 0.0)], now=(0.4, 0.0), ending=ending)[:, critics.ROTATE_TO_GOAL]
    assert math.isnan(moving[0])
    assert moving[1] == pytest.approx(5.0 * 0.3**2 + 1.0)
    assert moving[2] == pytest.approx(1.0)
    standing = scores_of([(0.1, 0.0), (0.0, 0.8), (0.0, -0.8)], ending=ending)[:, critics.ROTATE_TO_GOAL]
    assert math.isnan(standing[0])
    assert standing[1] == pytest.approx(0.2, abs=1e-6)
    assert standing[2] == pytest.approx(1.8, abs=1e-6)


def test_turning_back_is_banned_until_the_robot_has_got_away():
    planner = planner_to(3.0)
    turns = [planner.command(Pose2D(0.0, 0.0, theta), STOPPED, NOTHING).w for theta in (-1.5, 1.5, 1.5 - 0.19, -1.5)]
    assert turns[0] > 0.0 > turns[1]
    assert turns[2] <= 0.0 < turns[3]


def test_parameters_limit_speeds_and_change_the_forecast():
    variants = {}, {"max_vel_x": 0.3}, {"width": 10.0, "sim_time": 2.5}, {"acc_lim_x": 0.1, "vx_samples": 40}
    planners = [planner_to(8.0, load_robot("tugbot"), DwbParams(**params)) for params in variants]
    *speeds, gentle = (planner.command(ORIGIN, STOPPED, NOTHING).v for planner in planners)
    assert speeds == [0.78, 0.3, 0.78]
    assert 0.0 < gentle <= 0.1 * 1.7


def test_the_inflation_radius_is_that_of_nav2_and_at_least_the_footprint():
    box = np.array([[x, 0.62] for x in np.linspace(0.2, 1.5, 60)])
    planners = [planner_to(4.0, params=DwbParams(inflation_radius=radius)) for radius in (0.05, 0.3, 1.0)]
    squared = planners[0]._squared_gaps(box, planners[0]._side, 0.05, 180)
    costs = [planner._table[np.minimum(squared, len(planner._table) - 1)] for planner in planners]
    assert planners[0].command(ORIGIN, STOPPED, box).v > 0.0
    assert [np.count_nonzero(each) for each in costs] == sorted(np.count_nonzero(each) for each in costs)
    assert (costs[0][costs[0] > 0] >= 253).all()
    assert not (costs[1][costs[1] > 0] >= 253).all()


def test_turns_of_a_moving_robot_are_no_oscillation():
    banned = []
    for threshold in (0.05, math.inf):
        planner = planner_to(3.0, params=DwbParams(x_only_threshold=threshold))
        for y in (-0.1, 0.1):
            turn = planner.command(Pose2D(0.0, y, 0.0), Twist(0.2, 0.0), NOTHING)
            assert turn.v > 0.05
            assert turn.w * y < 0.0
        banned.append(planner._banned.tolist())
    assert banned == [[0.0, 0.0], [0.0, 1.0]]


@pytest.mark.parametrize(("tolerance", "least", "most"), [(0.6, 0.1, 0.3), (0.1, 0.0, 0.1)])
def test_the_robot_stops_within_the_smaller_tolerance_before_it_turns(tolerance, least, most):
    planner = planner_to(1.0, params=DwbParams(xy_goal_tolerance=0.3), heading=2.0, tolerance=tolerance)
    turning = next(pose for pose in drive(planner, BURGER, ORIGIN, 200) if abs(pose.theta) > 0.5)
    assert least < 1.0 - turning.x <= most


@pytest.mark.parametrize("wrong", [{"sim_time": 0.0}, {"vx_samples": 0}, {"resolution": -0.05}, {"max_vel_x": "fast"}])
def test_values_that_make_no_sense_are_named(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        DwbParams(**wrong)

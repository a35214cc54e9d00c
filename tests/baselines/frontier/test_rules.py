import numpy as np
import pytest

from lidarnaut import make_policy
from lidarnaut.agents.policy_names import parse_policy
from lidarnaut.agents.run_folder import CheckpointError
from lidarnaut.baselines import RrtParams
from lidarnaut.baselines.episode import run_episode
from lidarnaut.baselines.frontier.rules import ExploreLite, GainOverCostExplorer, NextBestViewParams
from lidarnaut.baselines.frontier.tour import TourParams
from lidarnaut.baselines.frontier.utility import FrontierParams
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.navigation import GainOverCost
from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.tasks.explore import Explore
from tests.baselines.maps import BURGER, belief_at, candidates_from, corridor, first_choice, hall, reading_of

NAMES = ["nearest", "frontier", "explore_lite", "gain_over_cost", "greedy_gain", "next_best_view", "tour"]
ROOMS = {"world": "rooms", "world_size": (8.0, 8.0), "physics": "kinematic", "target_coverage": 0.9}


def explore(name, seed, **arguments):
    env = LidarEnv(Explore, **arguments)
    episode = run_episode(env, parse_policy(name).make(env.action_space), seed)
    env.close()
    return episode


@pytest.mark.parametrize(("name", "physics"), [*((name, "kinematic") for name in (*NAMES, "rrt")), ("rrt", "bullet")])
def test_explorers_explore_a_small_world(name, physics):
    world = {"world": "turtlebot3_world", "slam": "tinyslam", "start": "spawn", "time_limit": 150.0}
    episode = explore(name, 1, physics=physics, **world)
    assert episode.explored_fraction >= 0.97
    assert episode.collisions == 0
    # The robot drives rather than turns.
    assert episode.path_length > 0.3 * episode.duration * BURGER.max_v


@pytest.mark.parametrize("name", ["pursuit", "pursuit:pretrained/frontiers"])
def test_pursuit_explores_and_touches_nothing(name):
    if "pretrained" in name:
        pytest.importorskip("torch")
    for seed in range(3):
        episode = explore(name, seed, **ROOMS)
        assert episode.explored_fraction >= 0.9
        assert episode.collisions == 0
    with pytest.raises(CheckpointError, match="twist is not a frontier score"):
        parse_policy("pursuit:pretrained/twist")


@pytest.mark.parametrize("name", ["frontier", "next_best_view", "rrt", "oracle"])
def test_same_seed_same_episode(name):
    first, second = (explore(name, 3, **ROOMS, time_limit=8.0).history for _ in range(2))
    for measured in ("time", "path_length", "explored_fraction"):
        np.testing.assert_array_equal(first.of(measured), second.of(measured))


@pytest.mark.parametrize("name", NAMES)
def test_in_a_closed_room_explorers_look_around_and_end(name):
    grid, explorer = hall(), make_policy(name)
    grid.data[64:96, 28:30] = grid.data[40:120, 230:232] = 100
    explorer.reset(BURGER, 0.1, np.random.default_rng(0))
    turns = []
    while explorer.end_reason is None and len(turns) < 200:
        turns.append(explorer.act(reading_of(time=0.1 * len(turns)), belief_at(5.0, 0.0, grid)).w)
    assert 0.1 * np.sum(turns) == pytest.approx(2.0 * np.pi, abs=0.2)
    assert explorer.end_reason == "no_reachable_frontier"
    assert explorer.act(reading_of(), belief_at(5.0, 0.0, grid)) == (0.0, 0.0)


@pytest.mark.parametrize(("name", "lacks"), [("nearest", "reset"), ("rrt", "reset"), ("oracle", "reveal")])
def test_a_reset_comes_first(name, lacks):
    with pytest.raises(RuntimeError, match=lacks):
        make_policy(name).act(reading_of(), belief_at(5.0, 0.0))


def test_nearest_goes_to_the_nearest_opening_that_has_not_failed():
    # The openings are at x = -0.1 and x = 10.1.
    assert first_choice(make_policy("nearest"), 4.0, 0.0)[0] < 0.0
    assert first_choice(make_policy("nearest"), 6.0, 0.0)[0] > 10.0
    candidates = candidates_from(4.0, 0.0)
    candidates["failures"][:] = candidates["frontier"][:, 0] < 0.0
    chosen = make_policy("nearest").rule(candidates, belief_at(4.0, 0.0)).argmax()
    assert candidates["frontier"][chosen][0] > 10.0


@pytest.mark.parametrize(("robot", "side"), [("turtlebot3_burger", "left"), ("tugbot", "right")])
def test_nearest_leaves_openings_narrower_than_the_robot_for_later(robot, side):
    grid, robot = hall(), load_robot(robot)
    grid.data[64:96, 28:30] = 100
    grid.data[74:86, 28:30] = 0  # 0.6 m
    explorer = make_policy("nearest")
    explorer.reset(robot, 0.1, np.random.default_rng(0))
    explorer.act(reading_of(robot=robot), belief_at(4.0, 0.0, grid))
    assert (explorer.navigator.target[0] < 5.0) == (side == "left")


def test_explore_lite_weighs_three_metres_against_nine_cells():
    # Frontiers of 60 cells 4 m to the left, and a larger one farther away to the right.
    published = make_policy("explore_lite:published")
    assert first_choice(published, 10.0, -0.5, corridor((100, 119), (280, 299)))[0] < 7.0
    assert first_choice(published, 10.0, -0.5, corridor((100, 119), (280, 339)))[0] > 13.0
    # Without gain, the nearer frontier is better.
    explorer = parse_policy("explore_lite?gain_scale=0.0").make()
    assert first_choice(explorer, 10.0, -0.5, corridor((103, 122), (280, 339)))[0] < 7.0


@pytest.mark.parametrize(
    ("explorer", "goes_far"),
    [
        (make_policy("greedy_gain"), True),
        (make_policy("next_best_view:published"), False),
        (parse_policy("next_best_view?discount=0.0").make(), True),
        (GainOverCostExplorer(), True),
        # A small added cost favours the nearest frontier; a high minimum gain makes all views equal.
        (GainOverCostExplorer(GainOverCost(least_gain=100.0, least_cost=0.1)), False),
    ],
)
def test_rules_weigh_a_crack_close_by_against_a_wide_opening_far_away(explorer, goes_far):
    x, _ = first_choice(explorer, 8.0, -0.5, corridor((180, 183), (300, 340)))
    assert x > 14.0 if goes_far else x < 10.0


def test_frontier_prefers_the_greater_gain_at_equal_distance():
    assert first_choice(make_policy("frontier"), 5.0, 0.0)[0] > 10.0
    # Much nearer to the small opening, the gain does not outweigh the distance.
    assert first_choice(make_policy("frontier"), 1.8, 0.0)[0] < 0.0


@pytest.mark.parametrize(
    ("params_type", "wrong"),
    [
        (TourParams, {"max_stops": 0}),
        (ExploreLite, {"gain_scale": -1.0}),
        (NextBestViewParams, {"discount": -0.1}),
        (GainOverCost, {"least_gain": 0.0}),
        (FrontierParams, {"cluster_tolerance": 0.0}),
        (FrontierParams, {"min_frontier_size_final": 9}),
        (FrontierParams, {"adaptive_threshold": 1.5}),
        (FrontierParams, {"obstacle_above": 100}),
        (FrontierParams, {"max_blacklist_size": 0}),
        (RrtParams, {"eta_local": 0.0}),
        (RrtParams, {"hysteresis_gain": 1.0}),
        (RrtParams, {"eta_global": 0.2}),
    ],
)
def test_params_refuse_nonsense(params_type, wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        params_type(**wrong)

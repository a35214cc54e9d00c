"""How rules choose, and that explorers explore a small world with them."""

import gymnasium
import numpy as np
import pytest

import envs  # noqa: F401
from baselines import (
    ExploreLite,
    ExploreLiteExplorer,
    FrontierExplorer,
    GainOverCostExplorer,
    GreedyGainExplorer,
    NearestExplorer,
    NextBestViewExplorer,
    NextBestViewParams,
    TourParams,
    make_explorer,
)
from baselines.explorer import to_action
from envs.explore_frontiers import ExploreFrontiersEnv
from envs.navigation import GainOverCost
from tests.baselines.maps import BURGER, belief_at, candidates_from, corridor, first_choice, hall, reading_of

NAMES = ["nearest", "frontier", "explore_lite", "gain_over_cost", "greedy_gain", "next_best_view", "tour"]


def explore(name, *, seed, max_time, **kwargs):
    """Run an episode; returns the explorer, the last info and all actions."""
    env = gymnasium.make("lidarnaut/Explore-v0", **kwargs).unwrapped
    _, info = env.reset(seed=seed)
    explorer = make_explorer(name)
    explorer.reset(env.robot, env.control_period, np.random.default_rng(seed))
    actions, done = [], False
    while not done and explorer.end_reason is None and info["time"] < max_time:
        actions.append(to_action(explorer.act(env.reading, env.belief), env.robot))
        assert env.action_space.contains(actions[-1])
        _, _, terminated, truncated, info = env.step(actions[-1])
        done = terminated or truncated
    env.close()
    return explorer, info, np.array(actions)


@pytest.mark.parametrize("name", NAMES)
def test_explorers_explore_a_small_world(name):
    world = {"world": "turtlebot3_world", "physics": "kinematic", "slam": "tinyslam", "start": "spawn"}
    _, info, _ = explore(name, seed=1, max_time=150.0, **world)
    assert info["explored_fraction"] >= 0.97
    assert info["collisions"] == 0
    # It drives rather than turns.
    assert info["path_length"] > 0.3 * info["time"] * BURGER.max_v


@pytest.mark.parametrize("name", ["frontier", "next_best_view"])
def test_same_seed_same_episode(name):
    runs = [explore(name, seed=3, max_time=8.0, world="rooms", physics="kinematic")[2] for _ in range(2)]
    np.testing.assert_array_equal(*runs)


@pytest.mark.parametrize("name", NAMES)
def test_rules_choose_at_decision_level_too(name):
    env, explorer = (
        ExploreFrontiersEnv(world="turtlebot3_world", physics="kinematic", start="spawn"),
        make_explorer(name),
    )
    env.reset(seed=0)
    if hasattr(explorer.rule, "reset"):
        explorer.rule.reset(env.robot, np.random.default_rng(0))
    for _ in range(3):
        choice = explorer.rule(env.candidates, env.belief).argmax()
        *_, info = env.step(np.int64(choice))
        assert info["action"] == choice
    assert info["explored_area"] > 5.0


@pytest.mark.parametrize("name", NAMES)
def test_in_a_closed_room_explorers_look_around_and_end(name):
    grid, explorer = hall(), make_explorer(name)
    grid.data[64:96, 28:30] = grid.data[40:120, 230:232] = 100
    explorer.reset(BURGER, 0.1, np.random.default_rng(0))
    turns = []
    while explorer.end_reason is None and len(turns) < 200:
        turns.append(explorer.act(reading_of(time=0.1 * len(turns)), belief_at(5.0, 0.0, grid)).w)
    assert 0.1 * np.sum(turns) == pytest.approx(2.0 * np.pi, abs=0.2)
    assert explorer.end_reason == "no_reachable_frontier"
    assert explorer.act(reading_of(), belief_at(5.0, 0.0, grid)) == (0.0, 0.0)


def test_a_reset_comes_first():
    with pytest.raises(RuntimeError, match="reset"):
        make_explorer("nearest").act(reading_of(), belief_at(5.0, 0.0))


def test_nearest_goes_to_the_nearest_opening():
    # The openings lie at x = -0.1 and x = 10.1.
    assert first_choice(NearestExplorer(), 4.0, 0.0)[0] < 0.0
    assert first_choice(NearestExplorer(), 6.0, 0.0)[0] > 10.0


def test_what_failed_comes_last():
    candidates = candidates_from(4.0, 0.0)
    nearest = make_explorer("nearest").rule
    first = nearest(candidates, belief_at(4.0, 0.0)).argmax()
    candidates["failures"][:] = np.hypot(*(candidates["frontier"] - candidates["frontier"][first]).T) < 2.0
    other = nearest(candidates, belief_at(4.0, 0.0)).argmax()
    assert candidates["frontier"][other][0] > 10.0


def test_explore_lite_weighs_three_metres_against_nine_cells():
    # Frontiers of 60 cells 4 m to the left, and of more cells than that farther away to the right.
    def goal_x(right, more):
        return first_choice(
            make_explorer("explore_lite:published"), 10.0, -0.5, corridor((100, 119), (right, right + 19 + more))
        )[0]

    assert goal_x(280, 0) < 7.0
    assert goal_x(280, 40) > 13.0
    # Without gain the nearer one is better whatever its size.
    explorer = ExploreLiteExplorer(ExploreLite(gain_scale=0.0))
    assert first_choice(explorer, 10.0, -0.5, corridor((103, 122), (280, 339)))[0] < 7.0


def test_greedy_gain_goes_far_for_more_and_the_published_next_best_view_does_not():
    grid = corridor((180, 183), (300, 340))
    assert first_choice(GreedyGainExplorer(), 8.0, -0.5, grid)[0] > 14.0
    assert first_choice(make_explorer("next_best_view:published"), 8.0, -0.5, grid)[0] < 10.0
    undiscounted = NextBestViewExplorer(NextBestViewParams(discount=0.0))
    assert first_choice(undiscounted, 8.0, -0.5, grid)[0] > 14.0


def test_gain_over_cost_weighs_what_is_in_view_against_the_path():
    # A crack 1 m away, and a wide opening 6 m away.
    grid = corridor((180, 183), (300, 340))
    assert first_choice(GainOverCostExplorer(), 8.0, -0.5, grid)[0] > 14.0
    # The less is added to the cost, the more the nearest counts; a high least gain makes all views alike.
    near = GainOverCostExplorer(GainOverCost(least_gain=100.0, least_cost=0.1))
    assert first_choice(near, 8.0, -0.5, grid)[0] < 10.0


def test_frontier_prefers_the_greater_gain_at_equal_distance():
    assert first_choice(FrontierExplorer(), 5.0, 0.0)[0] > 10.0
    # Far nearer to the small opening, the gain no longer pays the distance.
    assert first_choice(FrontierExplorer(), 1.8, 0.0)[0] < 0.0


@pytest.mark.parametrize(
    ("params_type", "wrong"),
    [
        (TourParams, {"max_stops": 0}),
        (TourParams, {"hysteresis": -1.0}),
        (ExploreLite, {"gain_scale": -1.0}),
        (NextBestViewParams, {"num_samples": 0}),
        (NextBestViewParams, {"discount": -0.1}),
        (GainOverCost, {"least_gain": 0.0}),
        (GainOverCost, {"least_cost": -1.0}),
    ],
)
def test_params_refuse_nonsense(params_type, wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        params_type(**wrong)

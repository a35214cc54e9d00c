"""The explorers in the environment, and how they choose."""

import gymnasium
import numpy as np
import pytest

import envs  # noqa: F401
from baselines import EXPLORERS, FrontierExplorer, FrontierParams, NearestExplorer, make_explorer
from baselines.explorer import to_action
from baselines.goal_explorer import Goal
from baselines.navigator import Navigator, Status
from envs.geometry import OccupancyGrid, Pose2D
from envs.robots import load_robot
from envs.slam import Belief
from tests.baselines.places import BURGER, NO_CELLS, chosen_by, hall, observation_of, survey_from


def explore(name, *, seed, max_time, **kwargs):
    """Run an episode; returns the explorer, the last info, all actions and the believed positions."""
    env = gymnasium.make("lidarnaut/Explore-v0", **kwargs).unwrapped
    _, info = env.reset(seed=seed)
    explorer = make_explorer(name)
    explorer.reset(env.robot, env.control_period, np.random.default_rng(seed))
    actions, positions, done = [], [], False
    while not done and explorer.end_reason is None and info["time"] < max_time:
        actions.append(to_action(explorer.act(env.reading, env.belief), env.robot))
        assert env.action_space.contains(actions[-1])
        _, _, terminated, truncated, info = env.step(actions[-1])
        positions.append(env.belief.pose[:2])
        done = terminated or truncated
    env.close()
    return explorer, info, np.array(actions), np.array(positions)


@pytest.mark.parametrize("name", ["nearest", "frontier"])
@pytest.mark.parametrize("physics", ["kinematic", "bullet"])
def test_frontier_explorers_get_to_know_a_small_world(name, physics):
    if physics == "bullet":
        pytest.importorskip("pybullet")
    _, info, actions, _ = explore(
        name, seed=1, max_time=120.0, world="turtlebot3_world", physics=physics, slam="tinyslam", start="spawn"
    )
    assert info["explored_fraction"] >= 0.95
    assert info["collisions"] == 0
    # It drives rather than turns.
    assert info["path_length"] > 0.3 * info["time"] * BURGER.max_v
    assert len(actions) == round(info["time"] / 0.1)


def test_an_explorer_says_when_nothing_is_left():
    explorer, info, _, _ = explore(
        "nearest",
        seed=0,
        max_time=300.0,
        world="turtlebot3_dqn_stage1",
        physics="kinematic",
        slam="truth",
        start="spawn",
        target_coverage=1.0,
    )
    assert explorer.end_reason == "no_reachable_frontier" or info["explored_fraction"] == 1.0
    assert info["explored_fraction"] > 0.98


def test_same_seed_same_episode():
    runs = [
        explore("frontier", seed=3, max_time=8.0, world="rooms", physics="kinematic", slam="tinyslam") for _ in range(2)
    ]
    np.testing.assert_array_equal(runs[0][2], runs[1][2])


def test_random_covers_the_action_space_and_follows_its_generator():
    explorer = make_explorer("random")
    draws = []
    for seed in (0, 0, 1):
        explorer.reset(BURGER, 0.1, np.random.default_rng(seed))
        draws.append(np.array([to_action(explorer.act(None, None), BURGER) for _ in range(2000)]))
    np.testing.assert_array_equal(draws[0], draws[1])
    assert not np.array_equal(draws[0], draws[2])
    assert draws[0].dtype == np.float32
    counts, _, _ = np.histogram2d(*draws[0].T, bins=4, range=[[-1, 1], [-1, 1]])
    assert counts.min() > 80
    assert counts.sum() == 2000


def test_unknown_names_are_answered_with_the_known_ones():
    with pytest.raises(ValueError, match=r"'teleporter'.*random, nearest, frontier"):
        make_explorer("teleporter")
    assert set(EXPLORERS) >= {"random", "nearest", "frontier"}


def test_nearest_goes_to_the_nearest_opening():
    # The openings lie at x = -0.1 and x = 10.1.
    assert chosen_by(NearestExplorer(), survey_from(4.0, 0.0)).frontier[0] < 0.0
    assert chosen_by(NearestExplorer(), survey_from(6.0, 0.0)).frontier[0] > 10.0


def test_frontier_prefers_the_greater_gain_at_equal_distance():
    goal = chosen_by(FrontierExplorer(), survey_from(5.0, 0.0))
    assert goal.frontier[0] > 10.0
    # Far nearer to the small opening, the gain no longer pays the way.
    assert chosen_by(FrontierExplorer(), survey_from(1.8, 0.0)).frontier[0] < 0.0


def test_frontier_leaves_out_what_failed_until_nothing_else_is_left():
    explorer = FrontierExplorer()
    explorer.reset(BURGER, 0.1, np.random.default_rng(0))
    wide, small = (10.1, 0.0), (-0.1, 0.0)
    survey = survey_from(5.0, 0.0)
    explorer._fail(survey, Goal((0, 0), wide))
    assert explorer._choose(survey).frontier[0] < 0.0
    # With both of them blacklisted, more than half is: the list is shortened and the older one is free again.
    explorer._fail(survey, Goal((0, 0), small))
    assert explorer._choose(survey).frontier[0] > 10.0


@pytest.mark.parametrize("explorer", [NearestExplorer(), FrontierExplorer()])
def test_a_frontier_that_cannot_be_got_to_is_given_up_in_the_end(explorer):
    explorer.reset(BURGER, 0.1, np.random.default_rng(0))
    survey = survey_from(5.0, 0.0)
    num_goals = 0
    while (goal := explorer._choose(survey)) is not None and num_goals < 100:
        explorer._fail(survey, goal)
        num_goals += 1
    assert 6 <= num_goals < 100


def test_frontier_relaxes_in_small_places_before_it_gives_up():
    # A corridor of 0.9 m: every frontier is nearer to walls than the clearance, and nearer than the least distance.
    data = np.full((60, 60), -1, dtype=np.int8)
    data[20:40, 20:38] = 0
    data[18:20, 20:38] = data[40:42, 20:38] = 100
    survey = survey_from(1.45, 1.5, OccupancyGrid(data, 0.05, (0.0, 0.0)))
    assert chosen_by(FrontierExplorer(), survey) is not None
    strict = FrontierExplorer()
    strict.reset(BURGER, 0.1, np.random.default_rng(0))
    cells = np.argwhere(survey.frontier)
    assert strict._best(survey, cells, FrontierParams()) is None


def test_a_closed_room_has_no_goals():
    grid = hall()
    grid.data[64:96, 28:30] = grid.data[40:120, 230:232] = 100
    for explorer in (NearestExplorer(), FrontierExplorer()):
        assert chosen_by(explorer, survey_from(5.0, 0.0, grid)) is None


def driving_navigator():
    navigator = Navigator(BURGER, 0.1, np.random.default_rng(0))
    navigator.drive_to((2.0, 0.0), np.column_stack([np.linspace(0, 2, 41), np.zeros(41)]))
    return navigator


def act(navigator, observation, belief):
    navigator.sense(observation)
    return navigator.act(observation, belief)


def test_obstacles_that_the_map_misses_are_planned_around():
    navigator, belief = driving_navigator(), Belief(Pose2D(3.0, 0.0, 0.0), hall(), NO_CELLS)
    observation = observation_of()
    ahead = np.abs(BURGER.lidar.angles) < 0.1
    observation["scan"][ahead] = 1.0 / BURGER.lidar.range_max
    navigator.sense(observation)
    navigator.drive_to((5.0, 0.0), np.array([[3.0, 0.0], [5.0, 0.0]]))
    survey = navigator.survey(belief)
    obstacle = 3.0 + BURGER.lidar.mount.x + 1.0
    assert survey.costmap.cost_at(obstacle, 0.0) == 254
    assert survey.grid.data.max() == belief.grid.data.max()
    assert not survey.frontier[tuple(survey.grid.cells(np.array([obstacle, 0.0])))]
    assert navigator.replan(survey)
    assert np.abs(navigator.plan - (obstacle, 0.0)).sum(axis=1).min() > BURGER.radius


def test_a_bump_makes_the_robot_back_off():
    navigator, belief = driving_navigator(), Belief(Pose2D(0.0, 0.0, 0.0), hall(), NO_CELLS)
    assert act(navigator, observation_of(), belief)[0] > 0.0
    assert act(navigator, observation_of(bump=True, action=(1.0, 0.0)), belief)[0] < 0.0
    assert act(navigator, observation_of(action=(-1.0, 0.0)), belief)[0] < 0.0


def test_a_robot_that_gets_nowhere_tries_to_free_itself_and_then_gives_the_goal_up():
    navigator, belief = driving_navigator(), Belief(Pose2D(0.0, 0.0, 0.0), hall(), NO_CELLS)
    actions = []
    for _ in range(400):
        actions.append(act(navigator, observation_of(), belief))
        if navigator.status is Status.FAILED:
            break
    assert navigator.status is Status.FAILED
    assert len(actions) <= 301
    assert np.array(actions)[:, 0].min() < 0.0


def test_a_goal_within_the_tolerance_is_reached():
    navigator = driving_navigator()
    act(navigator, observation_of(), Belief(Pose2D(1.9, 0.0, 0.0), hall(), NO_CELLS))
    assert navigator.status is Status.REACHED


def test_a_lidar_that_sees_no_full_turn_is_turned_to_what_is_to_be_seen():
    mouse = load_robot("raspimouse")
    belief = Belief(Pose2D(0.0, 0.0, 0.0), hall(), NO_CELLS)
    observation = {"scan": np.ones(mouse.lidar.num_beams, dtype=np.float32), "motion": np.zeros(6, dtype=np.float32)}
    for view, turns in (((1.0, 0.0), False), ((-1.0, 0.1), True)):
        navigator = Navigator(mouse, 0.1, np.random.default_rng(0))
        navigator.drive_to((0.0, 0.0), np.zeros((1, 2)), view=view)
        action = act(navigator, observation, belief)
        assert (navigator.status is Status.DRIVING) == turns
        assert (action[1] > 0.0) == turns
        assert action[0] == 0.0

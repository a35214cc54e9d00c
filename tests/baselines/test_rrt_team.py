"""Several robots with one assigner."""

import math

import numpy as np
import pytest

from baselines import RrtExplorer, RrtParams
from baselines.right_of_way import find_refuge, is_beside, outline
from baselines.rrt_team import RrtTeam
from baselines.survey import Survey
from envs.explore import ExploreEnv
from envs.explore_team import ExploreTeamEnv
from envs.geometry import OccupancyGrid, Pose2D
from envs.navigation import CostmapParams
from envs.robots import load_robot
from envs.slam import Belief
from envs.worlds import World

BURGER = load_robot("turtlebot3_burger")
NO_CELLS = np.empty((0, 2), dtype=np.int32)


def run(env, seed, max_time, watch=None):
    observation, info = env.reset(seed=seed)
    team = RrtTeam()
    team.reset(env.robot, env.control_period, env.num_robots, np.random.default_rng(seed))
    done = False
    while not done and team.end_reason is None and info["time"] < max_time:
        observation, _, terminated, truncated, info = env.step(team.act(observation, env.beliefs))
        done = terminated or truncated
        if watch is not None:
            watch(team, info)
    return team, info


def corridor(width=0.5, length=8.0, bay=None):
    """Two rooms of 2 m x 2 m joined by a corridor along x, with a bay on one side if wanted."""
    half, end = 0.5 * width, 0.5 * length
    low = [[-end, -half], [end, -half]]
    high = [[-end, half], [end, half]] if bay is None else []
    outline = [*low, [end, -1.0], [end + 2, -1.0], [end + 2, 1.0], [end, 1.0], [end, half]]
    if bay is not None:
        outline += [[bay + 0.4, half], [bay + 0.4, half + 0.8], [bay - 0.4, half + 0.8], [bay - 0.4, half]]
    outline += [[-end, half], [-end, 1.0], [-end - 2, 1.0], [-end - 2, -1.0], [-end, -1.0], [-end, -half]]
    assert high is not None
    points = np.array(outline)
    return World(
        name="corridor",
        segments=np.hstack([points[:-1], points[1:]]),
        circles=np.empty((0, 3)),
        spawns=(Pose2D(-end - 1.0, 0.0, 0.0),),
        bounds=(-end - 2, -1.0, end + 2, 1.0 + width),
    )


def test_a_team_of_one_does_what_the_single_explorer_does():
    kwargs = {"world": "rooms", "world_size": (8.0, 8.0), "physics": "kinematic"}
    env, team_env = ExploreEnv(**kwargs), ExploreTeamEnv(**kwargs, num_robots=1)
    params = RrtParams(patience=30)
    explorer, team = RrtExplorer(params), RrtTeam(params)
    (observation, _), (stacked, _) = env.reset(seed=3), team_env.reset(seed=3)
    explorer.reset(env.robot, env.control_period, np.random.default_rng(0))
    team.reset(env.robot, env.control_period, 1, np.random.default_rng(0))
    for _ in range(600):
        action, actions = explorer.act(observation, env.belief), team.act(stacked, team_env.beliefs)
        np.testing.assert_array_equal(action[None], actions)
        observation, *_ = env.step(action)
        stacked, *_ = team_env.step(actions)
    np.testing.assert_array_equal(explorer.points, team.points)


def test_two_robots_explore_a_small_world_without_touching():
    env = ExploreTeamEnv(world="rooms", world_size=(8.0, 8.0), physics="kinematic")
    apart = []
    _, info = run(env, 1, 200.0, lambda team, _: apart.append(team.targets))
    assert info["explored_fraction"] >= 0.99
    assert info["is_success"]
    assert info["collisions"].tolist() == [0, 0]
    both = np.array([targets for targets in apart if None not in targets])
    assert len(both) > 50
    assert np.hypot(*(both[:, 0] - both[:, 1]).T).min() > 0.4

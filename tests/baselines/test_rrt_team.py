"""Several robots with one assigner."""

import math

import numpy as np
import pytest

from baselines import RrtExplorer, RrtParams
from baselines.goal_explorer import Goal
from baselines.rrt_team import RrtTeam
from envs.explore import ExploreEnv
from envs.explore_team import ExploreTeamEnv
from envs.geometry import Pose2D
from envs.robots import load_robot
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


def corridor(width=0.45, length=4.0):
    """Two rooms of 2 m x 2 m, joined by a corridor along x in which two robots cannot pass each other."""
    side, end = 0.5 * width, 0.5 * length
    left = [[-end, side], [-end, 1.0], [-end - 2, 1.0], [-end - 2, -1.0], [-end, -1.0], [-end, -side]]
    right = [[end, -side], [end, -1.0], [end + 2, -1.0], [end + 2, 1.0], [end, 1.0], [end, side]]
    points = np.array([*left, *right, left[0]])
    return World(
        name="corridor",
        segments=np.hstack([points[:-1], points[1:]]),
        circles=np.empty((0, 3)),
        spawns=(Pose2D(-end - 1.0, 0.0, 0.0),),
        bounds=(-end - 2, -1.0, end + 2, 1.0),
    )


def send(team, env, targets, monkeypatch):
    """Let the robots drive to targets (x, y), world frame, on a map that they know already, and to nothing else."""
    grid, walls = env.beliefs[0].grid, env.coverage.area.walls
    rows, cols = np.nonzero(grid.data < 0)
    cells = walls.cells(env.start.transform(grid.centers(np.column_stack([rows, cols]))))
    inside = walls.contains(cells)
    grid.data[rows[inside], cols[inside]] = walls.data[tuple(cells[inside].T)]
    monkeypatch.setattr(team._detector, "detect", lambda *_: None)
    for member, target in zip(team._members, targets, strict=True):
        point = env.start.between(Pose2D(*target, 0.0))[:2]

        def choose(survey, point=point):
            row, col = survey.grid.cells(np.array(point))
            is_open = survey.field is not None and np.isfinite(survey.field.cost(np.array([row, col])))
            return Goal((int(row), int(col)), point) if is_open else None

        monkeypatch.setattr(member, "_choose", choose)
        monkeypatch.setattr(member, "_frontier_near", lambda *_: np.zeros((1, 2), dtype=np.int64))


@pytest.mark.parametrize("indices", [(0, 1), (1, 0)])
def test_two_robots_head_on_in_a_corridor_both_get_through(indices, monkeypatch):
    starts, targets = [(-2.3, 0.0, 0.0), (2.3, 0.0, math.pi)], [(3.3, 0.3), (-3.3, -0.3)]
    env = ExploreTeamEnv(
        world=corridor(),
        physics="kinematic",
        slam="truth",
        start=tuple(starts[k] for k in indices),
        target_coverage=1.0,
    )
    observation, info = env.reset(seed=0)
    team = RrtTeam()
    team.reset(env.robot, env.control_period, 2, np.random.default_rng(0))
    targets = [targets[k] for k in indices]
    send(team, env, targets, monkeypatch)
    arrived, met = [math.inf, math.inf], math.inf
    while max(arrived) == math.inf and info["time"] < 150.0:
        observation, _, _, _, info = env.step(team.act(observation, env.beliefs))
        poses = [member.state.pose for member in env.members]
        met = min(met, math.dist(poses[0][:2], poses[1][:2]))
        for k in range(2):
            if math.dist(poses[k][:2], targets[k]) < 0.25:
                arrived[k] = min(arrived[k], info["time"])
    assert met < 1.0
    # The lower index goes first.
    assert arrived[0] < arrived[1] < 150.0
    assert info["collisions"].tolist() == [0, 0]


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

import math

import numpy as np
import pytest

import lidarnaut.baselines.rrt.team as team_module
from lidarnaut.baselines import RrtExplorer, RrtParams
from lidarnaut.baselines.episode import run_episode
from lidarnaut.baselines.policy import to_action
from lidarnaut.baselines.rrt.detector import RrtDetector
from lidarnaut.baselines.rrt.team import RrtTeam
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.geometry import OCCUPIED, OccupancyGrid
from lidarnaut.envs.navigation.teams.team_navigator import UNASSIGNED
from lidarnaut.envs.tasks.explore import Explore, ExploreTeam
from tests.baselines.oracle.test_cover_planner import world_of


def drive(env, seed, grid=None):
    """Let a team drive for at most 150 s with its own map or `grid`; yield the team and the info after each step."""
    _, info = env.reset(seed=seed)
    team = RrtTeam()
    team.reset(env.robot_params, env.control_period, np.random.default_rng(seed))
    while team.end_reason is None and info["time"] < 150.0:
        beliefs = [Belief(robot.belief.pose, grid) if grid else robot.belief for robot in env.robots]
        twists = team.act([robot.reading for robot in env.robots], beliefs)
        *_, info = env.step(np.stack([to_action(twist, env.robot_params) for twist in twists]))
        yield team, info


LEFT = [(-2.0, 0.225), (-2.0, 1.0), (-4.0, 1.0), (-4.0, -1.0), (-2.0, -1.0), (-2.0, -0.225)]
CORRIDOR = world_of(*LEFT, *((-x, -y) for x, y in LEFT), start=(-3.0, 0.0))
"""Two rooms of 2 m x 2 m, joined by a corridor along x that is too narrow for two robots to pass."""


def known_map(env, targets):
    """Map of a world, with unknown cells around each target (x, y), world frame."""
    grid, walls = env.robots[0].belief.grid, env.task.coverage.area.walls
    data = grid.data.copy()
    rows, cols = np.nonzero(data < 0)
    cells = walls.cells(env.map_pose.transform(grid.centers(np.column_stack([rows, cols]))))
    inside = walls.contains(cells)
    data[rows[inside], cols[inside]] = walls.data[tuple(cells[inside].T)]
    # Also sampled from the other side, because thin walls would have holes.
    occupied = walls.centers(np.argwhere(walls.data == OCCUPIED))
    data[tuple(grid.cells(env.map_pose.inverse().transform(occupied)).T)] = OCCUPIED
    for row, col in grid.cells(env.map_pose.inverse().transform(np.array(targets))):
        data[row - 2 : row + 3, col - 2 : col + 3] = -1
    return OccupancyGrid(data, grid.resolution, grid.origin)


@pytest.mark.parametrize("indices", [(0, 1), (1, 0)])
def test_two_robots_head_on_in_a_corridor_both_get_through(indices, monkeypatch):
    starts, targets = [(-2.3, 0.0, 0.0), (2.3, 0.0, math.pi)], [(3.3, 0.3), (-3.3, -0.3)]
    settings = {"world": CORRIDOR, "physics": "kinematic", "slam": "truth", "target_coverage": 1.0}
    env = LidarEnv(ExploreTeam, **settings, start=tuple(starts[k] for k in indices))
    env.reset(seed=0)
    targets = [targets[k] for k in indices]
    grid, points = known_map(env, targets), env.map_pose.inverse().transform(np.array(targets))

    def assign_far_ends(grid, robots, found, costs, params, taken):
        chosen = np.full(len(robots), UNASSIGNED)
        for k, position in enumerate(robots):
            index = np.argmin([math.dist(position, robot.belief.pose[:2]) for robot in env.robots])
            gaps = np.hypot(*(found - points[index]).T)
            if len(gaps) and gaps.min() < 0.4 and np.isfinite(costs[k, gaps.argmin()]):
                chosen[k] = gaps.argmin()
        return chosen

    monkeypatch.setattr(team_module, "assign", assign_far_ends)
    monkeypatch.setattr(RrtDetector, "detect", lambda detector, *_: setattr(detector, "points", points))
    arrived, met = [math.inf, math.inf], math.inf
    for _, info in drive(env, 0, grid):
        positions = [truth.state.pose[:2] for truth in env.truths]
        met = min(met, math.dist(*positions))
        for k in range(2):
            if math.dist(positions[k], targets[k]) < 0.35:
                arrived[k] = min(arrived[k], info["time"])
        if max(arrived) < math.inf:
            break
    assert met < 1.0
    # The lower index goes first.
    assert arrived[0] < arrived[1] < 150.0
    assert info["collisions"].tolist() == [0, 0]


def test_a_team_of_one_explores_as_the_single_explorer_does():
    kwargs = {"world": "rooms", "world_size": (8.0, 8.0), "physics": "kinematic", "time_limit": 30.0}
    env, team_env = LidarEnv(Explore, **kwargs), LidarEnv(ExploreTeam, **kwargs, num_robots=1)
    params = RrtParams(patience=30)
    alone, team = run_episode(env, RrtExplorer(params), 3), run_episode(team_env, RrtTeam(params), 3)
    assert team.path_length == alone.path_length > 1.0


def test_two_robots_explore_a_small_world_without_touching():
    env = LidarEnv(ExploreTeam, world="rooms", world_size=(8.0, 8.0), physics="kinematic")
    targets = []
    for team, info in drive(env, 1):
        targets.append(team._navigator.targets)
        if "end_reason" in info:
            break
    assert info["explored_fraction"] >= 0.99
    assert info["is_success"]
    assert info["collisions"].tolist() == [0, 0]
    both = np.array([pair for pair in targets if None not in pair])
    assert len(both) > 50
    assert np.hypot(*(both[:, 0] - both[:, 1]).T).min() > 0.4

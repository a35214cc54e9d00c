"""The explorers of Nguyen et al. (2022): random trees find frontiers, a filter clusters them, revenue assigns them.

Nguyen, Tran and Nguyen, "SLAM cho robot di động" (2022), after Umari and Mukhopadhyay, "Autonomous Robotic Exploration
Based on Multiple Rapidly-exploring Randomized Trees" (2017). Where the report leaves something open, its launch file
and the program behind it decide, with these exceptions:

- *The region.* That program has a person click the corners of the region to sample. Ours is the rectangle around
  everything observed and a margin.
- *Navigation cost.* The report asks for the path that the robot is expected to drive; the program takes the straight
  distance. We take the path, weighted by nearness to obstacles.
- *Invalid points.* The report drops points that no path leads to, the program those in costly cells; we do both. A
  point's goal is the frontier cell nearest to it, because the mean of points along a bend lies beside the frontier.
  What the robot could not see from the viewpoint that it took for it is no frontier any more.
- *The end.* The program never ends. Here exploration is over when the robot has turned once around, and the trees have
  grown for `patience` steps, without any point that could be assigned. Trees are random, so more may be left than by an
  explorer that lists all frontier cells.

The robot keeps its point until it is there, or the frontier around it is gone. Each robot of a team has a local tree;
all share a global tree, the filter and the assigner.
"""

import math
from collections.abc import Sequence

import numpy as np

from lidarnaut.baselines.rrt.detector import TEAM_PARAMS, RrtDetector, RrtParams
from lidarnaut.baselines.rrt.robot import RrtRobot
from lidarnaut.baselines.teams.team import TeamExplorer
from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.geometry import OccupancyGrid
from lidarnaut.envs.navigation import NO_POINTS, Candidates
from lidarnaut.envs.navigation.frontiers import information_gain
from lidarnaut.envs.navigation.team_navigator import UNASSIGNED
from lidarnaut.envs.navigation.team_robot import TeamRobot
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Reading, Twist

SAME_POINT = 0.4
"""Points this near to one that another robot drives to are not assigned [m]."""


def assign(
    grid: OccupancyGrid,
    robots: np.ndarray,
    points: np.ndarray,
    costs: np.ndarray,
    params: RrtParams,
    taken: np.ndarray = NO_POINTS,
) -> np.ndarray:
    """Assign points by revenue (section 2.1.3): again and again the highest, until robots or points are used up.

    The revenue is R = lambda h(x_fp, x_r) I(x_fp) - N(x_fp), with lambda = `info_multiplier`, and h = `hysteresis_gain`
    within `hysteresis_radius` and 1 beyond, so that a robot finishes what is around it first. What a robot will see at
    its point is no gain for the others: unknown cells within `info_radius` of both points do not count any more.

    `robots` are positions x_r, shape (n, 2), `points` frontier points x_fp, shape (m, 2), `taken` points that other
    robots have already, shape (k, 2), all map frame [m]; `costs` are N, shape (n, m) [m], inf where there is no path.
    Returns the index of each robot's point, shape (n,), int64; `UNASSIGNED` where it can reach none that is left.
    """
    chosen = np.full(len(robots), UNASSIGNED, dtype=np.int64)
    gains = information_gain(grid, points, params.info_radius)
    for point in taken:
        gains = gains - information_gain(grid, points, params.info_radius, shared_with=point)
    gaps = robots[:, None] - points[None]
    is_near = np.hypot(gaps[..., 0], gaps[..., 1]) <= params.hysteresis_radius
    factors = params.info_multiplier * np.where(is_near, params.hysteresis_gain, 1.0)
    open_costs = costs.astype(np.float64)
    for _ in range(min(len(robots), len(points))):
        revenues = factors * gains - open_costs
        robot, point = np.unravel_index(np.argmax(revenues), revenues.shape)
        if math.isinf(revenues[robot, point]):
            break
        chosen[robot] = point
        gains = gains - information_gain(grid, points, params.info_radius, shared_with=points[point])
        open_costs[robot] = open_costs[:, point] = np.inf
    return chosen


class RrtTeam(TeamExplorer):
    """Explores with one or several robots by the points of random trees; a robot keeps its point."""

    def __init__(self, params: RrtParams = TEAM_PARAMS) -> None:
        super().__init__(period=math.inf)
        self._params = params
        self._detector: RrtDetector | None = None

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        """Prepare for a new episode; see `lidarnaut.baselines.explorer.Policy`."""
        super().reset(robot, control_period, rng)
        self._detector = RrtDetector(self._params, rng)

    @property
    def points(self) -> np.ndarray:
        """Frontier points that have passed the filter, shape (n, 2), float64, map frame [m]."""
        return NO_POINTS if self._detector is None else self._detector.points

    def _make_robot(self, index: int) -> RrtRobot:
        return RrtRobot(self._robot, self._control_period, self._params, index)

    def _look(self, team: Sequence[TeamRobot], beliefs: Sequence[Belief]) -> None:
        """Let the trees grow."""
        assert self._detector is not None
        self._detector.detect(beliefs[0].grid, [belief.pose[:2] for belief in beliefs])
        for robot in team:
            assert isinstance(robot, RrtRobot)
            robot.points = self.points

    def _command(self, robot: TeamRobot, belief: Belief) -> Twist:
        return robot.command(belief)

    def _assign(self, due: Sequence[TeamRobot], beliefs: Sequence[Belief]) -> list[int]:
        """Assign points to robots that have none, all together (`assign`)."""
        columns: dict[tuple[float, float], int] = {}
        goals = [open_goals(robot.candidates) for robot in due]
        for frontiers, _, _ in goals:
            for x, y in frontiers.tolist():
                columns.setdefault((x, y), len(columns))
        costs = np.full((len(due), len(columns)), np.inf)
        for row, (frontiers, lengths, _) in enumerate(goals):
            costs[row, [columns[x, y] for x, y in frontiers.tolist()]] = lengths
        points = np.array(list(columns)).reshape(-1, 2)
        taken = np.array([target for target in self.targets if target]).reshape(-1, 2)
        gaps = points[:, None] - taken
        costs[:, (np.hypot(gaps[..., 0], gaps[..., 1]) <= SAME_POINT).any(axis=1)] = np.inf
        positions = np.array([beliefs[robot.index].pose[:2] for robot in due]).reshape(-1, 2)
        chosen = assign(beliefs[0].grid, positions, points, costs, self._params, taken)
        return [
            int(indices[(frontiers == points[point]).all(axis=1).argmax()]) if point != UNASSIGNED else UNASSIGNED
            for (frontiers, _, indices), point in zip(goals, chosen, strict=True)
        ]


def open_goals(candidates: Candidates) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return what may be assigned to a robot: candidates that have failed only if there are no others.

    These are frontiers, shape (k, 2), map frame [m], the costs of the paths to their viewpoints [m], and their indices
    among the candidates.
    """
    indices = np.flatnonzero(candidates["failures"] == 0)
    if len(indices) == 0:
        indices = np.arange(len(candidates))
    return candidates["frontier"][indices], candidates["cost"][indices], indices


class RrtExplorer(RrtTeam):
    """Drives to the frontier point of the highest revenue that two random trees have found: a team of one robot."""

    is_team = False

    def __init__(self, params: RrtParams = RrtParams()) -> None:
        super().__init__(params)

    @property
    def plan(self) -> np.ndarray | None:  # type: ignore[override]
        """What is left of the planned path, shape (n, 2), map frame [m]; None without one."""
        return next(iter(self.plans), None)

    def act(self, reading: Reading, belief: Belief) -> Twist:  # type: ignore[override]
        """Return the twist; see `Explorer`."""
        return super().act([reading], [belief])[0]

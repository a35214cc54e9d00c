"""Seed 2's explorer: random trees find frontiers, a filter thins them out, an assigner picks one by revenue.

After Umari and Mukhopadhyay, "Autonomous Robotic Exploration Based on Multiple Rapidly-exploring Randomized Trees"
(2017). Where the seed leaves something open, its launch file and the program behind it decide, with these exceptions:

- *The region.* That program has a person click the corners of the region to sample. Ours is the rectangle around
  everything observed and a margin.
- *Navigation cost.* The seed asks for the way that the robot is expected to drive; the program takes the distance
  as the crow flies. We have the way, weighted by nearness to obstacles.
- *Invalid points.* The seed drops points that no way leads to, the program those in costly cells; we do both. A point's
  goal is the frontier cell nearest to it, because the mean of points along a bend lies beside the frontier. What the
  robot could not see from where it stood to look at it is no frontier any more.
- *The end.* The program never ends. Here exploration is over when the robot has turned once around, and the trees have
  grown for `patience` steps, without any point that could be assigned. Trees are random, so more may be left than by an
  explorer that lists all frontier cells.

The robot keeps its point until it is there, or the frontier around it is gone.
"""

from dataclasses import dataclass, fields

import numpy as np

from baselines.frontier_filter import information_gain, mean_shift
from baselines.goal_explorer import MAX_FAILURES, Goal, GoalExplorer
from baselines.navigator import Navigator
from baselines.rrt_assigner import assign
from baselines.rrt_goals import goals_of
from baselines.rrt_trees import Tree
from baselines.survey import Survey
from envs.navigation import crop_to_known
from envs.robots import RobotParams
from envs.slam import Belief


@dataclass(frozen=True, slots=True)
class RrtParams:
    """Defaults: the launch file of seed 2 (that of the published program for one robot), unless marked as ours."""

    eta_local: float = 1.0
    """Greatest step of the local tree [m]; launch file."""
    eta_global: float = 15.0
    """Greatest step of the global tree [m]; launch file, one robot (1 m with three robots)."""
    bandwidth: float = 0.3
    """Bandwidth of the mean shift [m]; the program's filter."""
    info_radius: float = 1.0
    """Radius around a point in which unknown area is its gain [m]; launch file."""
    min_gain: float = 0.2
    """Unknown area within half of that radius below which a point is stale [m2]; the program's filter."""
    max_cost: float = 70.0
    """Cost above which a point is invalid, on ROS's scale: 99 touches an obstacle [percent]; launch file."""
    info_multiplier: float = 3.0
    """Lambda: how much way a gain is worth [1/m]; launch file."""
    hysteresis_radius: float = 3.0
    """Distance from the robot up to which gains are multiplied [m]; launch file."""
    hysteresis_gain: float = 2.0
    """By what they are multiplied; launch file."""
    num_samples: int = 200
    """Samples per tree and control step; ours (the program takes 10 in 0.1 s, and one for each loop of its own)."""
    spacing: float = 0.3
    """Least distance of a new vertex from the nearest one [m]; ours."""
    margin: float = 1.0
    """How far beyond everything observed samples are drawn [m]; ours."""
    view_distances: tuple[float, ...] = (0.0, 0.3, 0.6, 1.0)
    """How far from a frontier the robot may stand to see it; the first from which it can is taken [m]; ours."""
    patience: int = 100
    """Control steps without a point that could be assigned after which exploration ends; ours."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name != "view_distances" and not value > 0:
                raise ValueError(f"{field.name} must be positive, got {value}")
        if not self.hysteresis_gain > 1:
            raise ValueError(f"hysteresis_gain must be greater than 1, got {self.hysteresis_gain}")
        if not self.view_distances or min(self.view_distances) < 0:
            raise ValueError(f"view_distances must hold distances of at least 0, got {self.view_distances}")
        if not min(self.eta_local, self.eta_global) >= self.spacing:
            raise ValueError(f"spacing must be at most eta_local and eta_global, got {self.spacing}")


class RrtExplorer(GoalExplorer):
    """Goes to the frontier point of the greatest revenue among those that two random trees have run into."""

    def __init__(self, params: RrtParams = RrtParams()) -> None:
        """Make an explorer with the given parameters."""
        super().__init__()
        self._params = params

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        """Prepare for a new episode; see `Explorer`."""
        super().reset(robot, control_period, rng)
        self._rng = rng
        self._trees: list[Tree] = []
        self._points = np.empty((0, 2))
        self._idle_steps = 0

    @property
    def points(self) -> np.ndarray:
        """Frontier points that have passed the filter, shape (n, 2), float64, map frame [m]."""
        return self._points

    @property
    def trees(self) -> list[Tree]:
        """The local and the global tree; none before the first step."""
        return self._trees

    def act(self, observation: dict[str, np.ndarray], belief: Belief) -> np.ndarray:
        """Return the action; see `Explorer`."""
        if self._navigator is not None and self._end_reason is None:
            self._detect(belief)
        return super().act(observation, belief)

    def _detect(self, belief: Belief) -> None:
        """Let the trees grow, and the filter take in what they find."""
        params, robot = self._params, belief.pose[:2]
        if not self._trees:
            self._trees = [
                Tree(robot, eta=params.eta_local, spacing=params.spacing, resets=True),
                Tree(robot, eta=params.eta_global, spacing=params.spacing, resets=False),
            ]
        x0, y0, x1, y1 = crop_to_known(belief.grid).bounds
        low, high = np.array([x0, y0]) - params.margin, np.array([x1, y1]) + params.margin
        found = [
            tree.grow(belief.grid, self._rng.uniform(low, high, (params.num_samples, 2)), robot) for tree in self._trees
        ]
        points = mean_shift(np.concatenate([self._points, *found]), params.bandwidth)
        gains = information_gain(belief.grid, points, 0.5 * params.info_radius)
        self._points = points[gains >= params.min_gain]
        self._idle_steps += 1

    def _consider(self, navigator: Navigator, belief: Belief) -> None:
        super()._consider(navigator, belief)
        if self._goal is not None:
            self._idle_steps = 0
        elif self._idle_steps < self._params.patience:
            self._end_reason = None

    def _choose(self, survey: Survey) -> Goal | None:
        if survey.field is None:
            return None
        params = self._params
        places, cells = goals_of(
            survey,
            self._points,
            max_cost=params.max_cost,
            radius=params.bandwidth,
            view_distances=params.view_distances,
        )
        frontiers = survey.grid.centers(cells)
        failures = self._count_failures(frontiers)
        # Places that the robot failed to get to come last.
        for allowed_failures in (0, MAX_FAILURES - 1):
            is_open = failures <= allowed_failures
            if is_open.any():
                best = np.flatnonzero(is_open)[self._assigned(survey, places[is_open], frontiers[is_open])]
                (row, col), (x, y) = places[best], frontiers[best]
                return Goal((int(row), int(col)), (float(x), float(y)))
        return None

    def _assigned(self, survey: Survey, places: np.ndarray, frontiers: np.ndarray) -> int:
        """Return the index of the frontier (x, y) [m] of the greatest revenue, seen from its place (row, column)."""
        assert survey.field is not None
        params = self._params
        chosen = assign(
            survey.grid,
            np.array([survey.pose[:2]]),
            frontiers,
            survey.field.cost(places)[None],
            info_radius=params.info_radius,
            info_multiplier=params.info_multiplier,
            hysteresis_radius=params.hysteresis_radius,
            hysteresis_gain=params.hysteresis_gain,
        )
        return int(chosen[0])

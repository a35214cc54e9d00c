"""The explorer of Nguyen et al. (2022): random trees find frontiers, a filter clusters them, revenue picks one.

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

The robot keeps its point until it is there, or the frontier around it is gone.
"""

import numpy as np

from baselines.rrt.params import RrtParams
from baselines.rrt.team import RrtTeam
from envs.estimation import Belief
from envs.robots import RobotParams
from envs.simulation import Reading, Twist


class RrtExplorer:
    """Drives to the frontier point of the highest revenue that two random trees have found: a team of one robot."""

    def __init__(self, params: RrtParams = RrtParams()) -> None:
        self._team = RrtTeam(params)

    @property
    def end_reason(self) -> str | None:
        """Why no point is left: `"no_reachable_frontier"`, or `"stuck"` if the robot could not move; None before."""
        return self._team.end_reason

    @property
    def plan(self) -> np.ndarray | None:
        """What is left of the planned path, shape (n, 2), map frame [m]; None without one."""
        return next(iter(self._team.plans), None)

    @property
    def points(self) -> np.ndarray:
        """Frontier points that have passed the filter, shape (n, 2), float64, map frame [m]."""
        return self._team.points

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        self._team.reset(robot, control_period, rng)

    def act(self, reading: Reading, belief: Belief) -> Twist:
        return self._team.act([reading], [belief])[0]

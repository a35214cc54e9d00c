"""Observation of planned paths to the best frontiers."""

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.files import load_object
from lidarnaut.envs.navigation import FrontierNavigator, GainOverCost
from lidarnaut.envs.navigation.controllers.regulated_pursuit import nearest_index
from lidarnaut.envs.navigation.frontiers.candidates import HALF_AREA, HALF_COST
from lidarnaut.envs.navigation.planners import FrontierPlanner, Rating
from lidarnaut.envs.robot import Robot
from lidarnaut.envs.simulation import Twist
from lidarnaut.envs.task import BoxPart

LOOKAHEADS = (0.3, 0.6, 1.5)
"""Lookahead distances along a path [m]."""
WIDTH = 2 * len(LOOKAHEADS) + 3
NUM_FRONTIERS, MAX_CANDIDATES = 3, 48
"""Maximum numbers of frontiers observed, and evaluated."""
DETECTION_TIME = 1.0
"""Time between frontier detections [s]."""
WINDOW = 60
"""The path point nearest to the robot is searched among this number of points, beginning at the last nearest point."""


@njit(cache=True, error_model="numpy")
def look_ahead(path, first, pose, distances, out):
    """Write the directions from a robot to lookahead points on a path; return the index of the nearest path point.

    `path`: shape (n, 2), float64, map frame [m]. `first`: index to begin the search. `pose`: (x, y, theta), map frame.
    `distances`: increasing lookahead distances [m]. `out`: cosine and sine of each direction, robot frame, float32.
    """
    x, y, theta = pose
    nearest = nearest_index(path, x, y, first, WINDOW)
    ahead, length = nearest, 0.0
    for i in range(len(distances)):
        while ahead + 1 < path.shape[0] and length < distances[i]:
            length += math.hypot(path[ahead + 1, 0] - path[ahead, 0], path[ahead + 1, 1] - path[ahead, 1])
            ahead += 1
        angle = math.atan2(path[ahead, 1] - y, path[ahead, 0] - x) - theta
        out[2 * i], out[2 * i + 1] = math.cos(angle), math.sin(angle)
    return nearest


def rate_by_rule(navigator: FrontierNavigator, belief: Belief) -> np.ndarray:
    """Rate candidates by the rule `gain_over_cost`."""
    return GainOverCost()(navigator.candidates, belief)


class Plan(BoxPart):
    """Observation of planned paths to the three best frontiers: `Box(-1, 1, (27,), float32)`.

    Features of each frontier, best first by its rating: cosine and sine of the directions, robot frame, to points
    0.3 m, 0.6 m and 1.5 m ahead on the path; path cost as x / (x + 5 m); visible unknown area as x / (x + 10 m2); and a
    presence flag, 1. Missing frontiers are all 0.

    `FrontierPlanner` plans the paths. Call `write` after every control period.
    """

    size = WIDTH * NUM_FRONTIERS

    def __init__(self, rating: str | Callable[[], Rating] | None = None) -> None:
        """Create the observation.

        `rating`: function that returns a rating of frontiers, or its name, such as
        "lidarnaut.agents.frontiers.score:pretrained_rating"; None for `gain_over_cost`.
        """
        make = load_object(rating) if isinstance(rating, str) else rating
        self._rate: Rating = make() if make else rate_by_rule
        self._name = "frontiers", self if callable(rating) else rating

    def reset(self, robot: Robot) -> None:
        self._planner(robot)

    def _planner(self, robot: Robot) -> FrontierPlanner:
        limits = {"max_time": DETECTION_TIME, "max_candidates": MAX_CANDIDATES}
        make = partial(FrontierPlanner, robot.params, robot.control_period, self._rate, **limits)
        planner: FrontierPlanner = robot.planner(self._name, make)
        planner.num_paths = NUM_FRONTIERS
        return planner

    def write(self, robot: Robot, out: np.ndarray) -> None:
        planner, rows, pose = self._planner(robot), out.reshape(-1, WIDTH), tuple(robot.belief.pose)
        planner.update(robot.reading, robot.belief, Twist(*robot.action), [peer.belief for peer in robot.peers])
        rows[:] = 0.0
        for k, path in enumerate(planner.paths):
            planner.nearest[k] = look_ahead(path, planner.nearest[k], pose, LOOKAHEADS, rows[k])
            cost, visible = planner.table["cost"][k], planner.table["visible"][k]
            rows[k, -3:] = cost / (cost + HALF_COST), visible / (visible + HALF_AREA), cost >= 0.0

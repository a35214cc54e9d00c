"""Observation of planned paths to the best frontiers."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.files import load_object
from lidarnaut.envs.navigation import FrontierNavigator, GainOverCost
from lidarnaut.envs.navigation.controllers.regulated_pursuit import nearest_index
from lidarnaut.envs.navigation.frontiers.candidates import HALF_AREA, HALF_COST
from lidarnaut.envs.robot import Robot
from lidarnaut.envs.simulation import Twist
from lidarnaut.envs.task import BoxPart

LOOKAHEADS = (0.3, 0.6, 1.5)
"""Lookahead distances along a path [m]."""
WIDTH = 2 * len(LOOKAHEADS) + 3
Rating = Callable[[FrontierNavigator, Belief], np.ndarray]
"""Function that returns a score for each candidate of a navigator, shape (k,), float64, k >= 0."""
WINDOW = 60
"""The path point nearest to the robot is searched among this number of points, beginning at the last nearest point."""


@njit(cache=True, error_model="numpy")
def look_ahead(path, first, pose, distances, out):
    """Write the directions from a robot to lookahead points on a path; return the index of the nearest path point.

    `path`: shape (n, 2), float64, map frame [m]. `first`: index to begin the search. `pose`: (x, y, theta), map frame.
    `distances`: increasing lookahead distances [m]. `out`: cosine and sine of each direction, robot frame, float32.
    """
    x, y, theta = pose
    at = nearest = nearest_index(path, x, y, first, WINDOW)
    length = 0.0
    for i in range(len(distances)):
        while at + 1 < path.shape[0] and length < distances[i]:
            length += math.hypot(path[at + 1, 0] - path[at, 0], path[at + 1, 1] - path[at, 1])
            at += 1
        angle = math.atan2(path[at, 1] - y, path[at, 0] - x) - theta
        out[2 * i], out[2 * i + 1] = math.cos(angle), math.sin(angle)
    return nearest


def rate_by_rule(navigator: FrontierNavigator, belief: Belief) -> np.ndarray:
    """Rate candidates by the rule `gain_over_cost`."""
    return GainOverCost()(navigator.candidates, belief)


class Plan(BoxPart):
    """Observation of planned paths to the best frontiers: `Box(-1, 1, (9 * num_candidates,), float32)`.

    Features of each frontier, best first by its rating: cosine and sine of the directions, robot frame, to points
    0.3 m, 0.6 m and 1.5 m ahead on the path; path cost as x / (x + 5 m); visible unknown area as x / (x + 10 m2); and a
    presence flag, 1. Missing frontiers are all 0.

    Frontiers are detected every `detection_time` seconds, and when the best frontier is reached. Frontiers that remain
    after a visit or are unreachable are excluded. Call `write` after every control period.
    """

    def __init__(
        self,
        detection_time: float = 1.0,
        num_candidates: int = 3,
        max_candidates: int = 48,
        rating: str | Callable[[], Rating] = lambda: rate_by_rule,
    ) -> None:
        """Create the observation.

        `detection_time`: time between frontier detections [s]. `num_candidates`, `max_candidates`: maximum numbers of
        frontiers observed and evaluated. `rating`: function that returns a rating of frontiers, `gain_over_cost` by
        default; or its name, such as "lidarnaut.agents.frontiers.score:pretrained_rating".
        """
        if not detection_time > 0 or not 0 < num_candidates <= max_candidates:
            given = f"{detection_time!r}, {num_candidates!r} and {max_candidates!r}"
            wanted = "a positive detection_time and 0 < num_candidates <= max_candidates"
            raise ValueError(f"plan needs {wanted}, got {given}")
        self._detection_time, self._num, self._max = detection_time, num_candidates, max_candidates
        self._rate: Rating = (load_object(rating) if isinstance(rating, str) else rating)()
        self.size = WIDTH * num_candidates
        self._detections: dict[Robot, _Detection] = {}

    def reset(self, robot: Robot) -> None:
        limits: Any = {"max_candidates": self._max, "max_time": self._detection_time}
        navigator = FrontierNavigator(robot.params, robot.control_period, **limits)
        self._detections[robot] = _Detection(robot, navigator, self._num, self._rate)

    def write(self, robot: Robot, out: np.ndarray) -> None:
        detection = self._detections[robot]
        detection.update(robot)
        detection.write(robot, out.reshape(-1, WIDTH))


class _Detection:
    def __init__(self, robot: Robot, navigator: FrontierNavigator, num: int, rate: Rating) -> None:
        self._navigator, self._num, self._rate, self._reading = navigator, num, rate, robot.reading
        self._paths: list[np.ndarray] = []
        navigator.begin(robot.reading, robot.belief)
        self._choose(robot.belief)

    def update(self, robot: Robot) -> None:
        navigator, belief = self._navigator, robot.belief
        if robot.reading is self._reading:
            return
        self._reading = robot.reading
        if navigator.navigator.is_recovering:
            # Recovery behaviors advance with each command, which is not executed.
            navigator.command(belief)
        navigator.navigator.note_command(Twist(*robot.action))
        for peer in robot.peers:
            navigator.integrate(peer.belief)
        if belief.update.redrawn and belief.update.correction is not None:
            self._paths = [belief.update.correction.apply(path) for path in self._paths]
        if navigator.update(robot.reading, belief) is not None:
            self._choose(belief)

    def write(self, robot: Robot, rows: np.ndarray) -> None:
        rows[:] = 0.0
        for k, path in enumerate(self._paths):
            self._nearest[k] = look_ahead(path, self._nearest[k], tuple(robot.belief.pose), LOOKAHEADS, rows[k])
            rows[k, -3:] = self._values[k]

    def _choose(self, belief: Belief) -> None:
        navigator, candidates = self._navigator, self._navigator.candidates
        scores = np.asarray(self._rate(navigator, belief))
        if scores.shape != (len(candidates),):
            raise ValueError(f"rating of plan must return {len(candidates)} scores, got shape {scores.shape}")
        best = np.argsort(-scores, kind="stable")[: self._num].tolist()
        # The frontier lies beyond the viewpoint at the path's end.
        self._paths = [np.vstack([navigator.path_to(k), candidates["frontier"][k]]) for k in best]
        self._nearest = [0] * len(best)
        costs, visible = candidates["cost"][best], candidates["visible"][best]
        self._values = np.column_stack([costs / (costs + HALF_COST), visible / (visible + HALF_AREA), costs >= 0.0])
        if best:
            navigator.choose(best[0])
        else:
            navigator.look_around()

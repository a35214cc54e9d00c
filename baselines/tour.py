"""A tour planner in TARE's manner: viewpoints over the frontiers, a short tour past them, its first stop is the goal.

After Cao, Zhu, Choset, Zhang, "TARE: A Hierarchical Framework for Efficiently Exploring Complex 3D Environments", 2021.
One level of tour over the nearest viewpoints takes the place of its two; the way past all that is left still decides
what comes first, so that nothing small is left behind for which the robot would have to return.
"""

import math
from dataclasses import dataclass

import numpy as np

from baselines.candidates import goal_for
from baselines.goal_explorer import MAX_FAILURES, Goal, GoalExplorer
from baselines.open_tour import best_tours
from baselines.survey import Survey
from envs.navigation import TravelField, frontier_clusters, travel_field
from envs.robots import RobotParams

FAR = 1e4
"""Length that stands for no way between two stops [m]."""


@dataclass(frozen=True, slots=True)
class TourParams:
    """How to place viewpoints and to keep to a tour."""

    sizes: tuple[int, ...] = (8, 3)
    """Least number of touching frontier cells; the next one is taken when nothing of the size before can be reached."""
    cover: float = 0.4
    """Frontier cells this near to one that a viewpoint is for need none of their own, in ranges of the lidar..."""
    max_cover: float = 3.0
    """...and at most this far [m]."""
    max_stops: int = 16
    """Viewpoints that the tour leads past: the ones that are cheapest to get to."""
    hysteresis: float = 1.0
    """How much shorter a tour must be for the robot to turn away from the frontier that it is going to see [m]."""

    def __post_init__(self) -> None:
        if not self.sizes or min(self.sizes) < 1:
            raise ValueError(f"sizes must be at least 1, got {self.sizes}")
        if not self.max_stops >= 1:
            raise ValueError(f"max_stops must be at least 1, got {self.max_stops}")
        for name in ("cover", "max_cover", "hysteresis"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name} must not be negative, got {getattr(self, name)}")


class TourExplorer(GoalExplorer):
    """Goes to the first stop of a short tour past the frontiers."""

    def __init__(self, params: TourParams = TourParams()) -> None:
        """Make an explorer with the given parameters."""
        super().__init__()
        self._params = params

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        """Prepare for a new episode; see `Explorer`."""
        super().reset(robot, control_period, rng)
        self._cover = min(self._params.cover * robot.lidar.range_max, self._params.max_cover)
        self._last: tuple[float, float] | None = None

    def _choose(self, survey: Survey) -> Goal | None:
        goal = self._first_stop(survey)
        if goal is not None:
            self._last = goal.frontier
        return goal

    def _better(self, survey: Survey, goal: Goal) -> Goal | None:
        other = self._first_stop(survey)
        if other is None or _gap(other.frontier, goal.frontier) <= self._cover:
            return None
        self._last = other.frontier
        return other

    def _first_stop(self, survey: Survey) -> Goal | None:
        """Return where the tour goes first; None if there is nothing that can be reached."""
        if survey.field is None:
            return None
        clusters = frontier_clusters(survey.frontier)
        # Places that the robot failed to get to come last.
        for allowed_failures in (0, MAX_FAILURES):
            for size in self._params.sizes:
                stops = self._stops(survey, survey.field, clusters, size)
                stops = [stop for stop in stops if self._num_failures(stop.frontier) <= allowed_failures]
                if stops:
                    return self._first_of(survey, survey.field, stops)
        return None

    def _stops(self, survey: Survey, field: TravelField, clusters: list[np.ndarray], size: int) -> list[Goal]:
        """Cover the clusters of at least `size` cells with viewpoints, one after the other."""
        stops: list[Goal] = []
        for cluster in clusters:
            cells = cluster
            while len(cells) >= size:
                stop = goal_for(survey, field, cells)
                if stop is None:
                    break
                stops.append(stop)
                gaps = np.hypot(*(survey.grid.centers(cells) - stop.frontier).T)
                # The frontier cell itself goes even where rounding puts it beside its centre.
                cells = cells[gaps > max(self._cover, 0.5 * survey.grid.resolution)]
        return stops

    def _first_of(self, survey: Survey, field: TravelField, stops: list[Goal]) -> Goal:
        """Return the first stop of the shortest tour, in favour of the one that the robot has been going to."""
        places = np.array([stop.cell for stop in stops])
        costs = field.cost(places)
        nearest = np.argsort(costs, kind="stable")[: self._params.max_stops]
        stops = [stops[k] for k in nearest]
        _, totals = best_tours(_lengths(survey, places[nearest], costs[nearest]))
        if self._last is not None:
            gaps = [_gap(stop.frontier, self._last) for stop in stops]
            same = int(np.argmin(gaps))
            if gaps[same] <= self._cover:
                totals[same] -= self._params.hysteresis
        return stops[int(np.argmin(totals))]


def _gap(a: tuple[float, float], b: tuple[float, float]) -> float:
    return math.hypot(a[0] - b[0], a[1] - b[1])


def _lengths(survey: Survey, places: np.ndarray, costs: np.ndarray) -> np.ndarray:
    """Measure the ways between the robot (index 0) and all stops.

    Args:
        survey: where they are.
        places: shape (n, 2), int64, cells of the stops.
        costs: shape (n,), float64, of the ways from the robot [m].

    Returns:
        Shape (n + 1, n + 1), float64, symmetric, finite [m].
    """
    lengths = np.zeros((len(places) + 1, len(places) + 1))
    lengths[0, 1:] = lengths[1:, 0] = costs
    for k in range(len(places) - 1):
        x, y = survey.grid.centers(places[k])
        field = travel_field(survey.costmap, (float(x), float(y)))
        ways = np.full(len(places) - k - 1, np.inf) if field is None else field.cost(places[k + 1 :])
        lengths[k + 1, k + 2 :] = lengths[k + 2 :, k + 1] = ways
    return np.minimum(lengths, FAR)

"""A tour planner in TARE's manner: viewpoints over the frontiers, a short tour past them, its first stop is the goal.

After Cao, Zhu, Choset, Zhang, "TARE: A Hierarchical Framework for Efficiently Exploring Complex 3D Environments", 2021.
One level of tour over the nearest viewpoints takes the place of its two; the way past all that is left still decides
what comes first, so that no dead end is left behind for which the robot would have to return. Small frontiers wait
until there are no larger ones: they rarely show enough to be worth a turn.
"""

import math
from dataclasses import dataclass

import numpy as np

from baselines.candidates import goal_for
from baselines.goal_explorer import MAX_FAILURES, Goal, GoalExplorer
from baselines.open_tour import best_tours
from baselines.survey import Survey
from envs.geometry import OccupancyGrid
from envs.navigation import COST_UNKNOWN, Costmap, TravelField, frontier_clusters, travel_field
from envs.robots import RobotParams

FAR = 1e4
"""Length that stands for no way between two stops [m]."""


@dataclass(frozen=True, slots=True)
class TourParams:
    """How to place viewpoints and to keep to a tour."""

    sizes: tuple[int, ...] = (16, 8, 3)
    """Least number of touching frontier cells; the next one is taken when nothing of the size before can be reached. A
    corner that furniture hides has few, is worth little, and lies beside the way at some later time as often as not."""
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

    def _choose(self, survey: Survey) -> Goal | None:
        return self._first_stop(survey, self._goal)

    def _better(self, survey: Survey, goal: Goal) -> Goal | None:
        other = self._first_stop(survey, goal)
        return None if other is None or _gap(other.frontier, goal.frontier) <= self._cover else other

    def _first_stop(self, survey: Survey, last: Goal | None) -> Goal | None:
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
                    return self._first_of(survey, survey.field, stops, last)
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

    def _first_of(self, survey: Survey, field: TravelField, stops: list[Goal], last: Goal | None) -> Goal:
        """Return the first stop of the shortest tour, in favour of the one that the robot has been going to."""
        places = np.array([stop.cell for stop in stops])
        costs = field.cost(places)
        nearest = np.argsort(costs, kind="stable")[: self._params.max_stops]
        stops = [stops[k] for k in nearest]
        _, totals = best_tours(_lengths(survey, places[nearest]))
        if last is not None:
            gaps = [_gap(stop.frontier, last.frontier) for stop in stops]
            same = int(np.argmin(gaps))
            if gaps[same] <= self._cover:
                totals[same] -= self._params.hysteresis
        return stops[int(np.argmin(totals))]


def _gap(a: tuple[float, float], b: tuple[float, float]) -> float:
    return math.hypot(a[0] - b[0], a[1] - b[1])


def _lengths(survey: Survey, places: np.ndarray) -> np.ndarray:
    """Measure the ways between the robot (index 0) and all stops.

    Cells as large as the robot's radius do for that, and take a tenth of the time. A cell is open where any part of it
    is. That opens no walls, since the robot's radius closes what is around them; a passage that is only a little too
    narrow may count as one.

    Args:
        survey: where they are.
        places: shape (n, 2), int64, cells of the stops.

    Returns:
        Shape (n + 1, n + 1), float64, symmetric, finite [m].
    """
    coarse = _pool(survey.costmap)
    points = np.vstack([survey.pose[:2], survey.grid.centers(places)])
    cells = coarse.grid.cells(points)
    lengths = np.zeros((len(points), len(points)))
    for k in range(len(points) - 1):
        field = travel_field(coarse, (float(points[k, 0]), float(points[k, 1])))
        ways = np.full(len(points) - k - 1, np.inf) if field is None else field.cost(cells[k + 1 :])
        lengths[k, k + 1 :] = lengths[k + 1 :, k] = ways
    return np.minimum(lengths, FAR)


def _pool(costmap: Costmap) -> Costmap:
    """Return a costmap of cells as large as the robot's radius, each as dear as its cheapest part."""
    size = max(1, int(costmap.params.robot_radius / costmap.grid.resolution))
    height, width = costmap.costs.shape
    padded = np.pad(costmap.costs, ((0, -height % size), (0, -width % size)), constant_values=COST_UNKNOWN)
    costs = padded.reshape(padded.shape[0] // size, size, -1, size).min(axis=(1, 3))
    grid = OccupancyGrid(np.zeros(costs.shape, dtype=np.int8), size * costmap.grid.resolution, costmap.grid.origin)
    return Costmap(costs, grid, costmap.params)

import math

import numpy as np

from lidarnaut.baselines.oracle.cover_tour import Cover, search_tour
from lidarnaut.baselines.oracle.cover_viewpoints import Viewpoints, pack_bits, unpack_bits, views_from
from lidarnaut.envs.worlds import ExplorableArea

MAX_SAMPLES = 8192
STOP_COST = 0.1
"""Cost of a stop on a tour, expressed as path length [m]."""
PASSED_SHARE = 0.5
"""Fraction of the lidar range within which an unobserved cell counts as missed when the robot passes a viewpoint."""
MAX_MISSES = 2


class CoverPlanner:
    """Planner of a short tour of viewpoints that observe the explorable area.

    Cells that stay unobserved at `MAX_MISSES` viewpoints, although visible from there, are ignored. The tour observes
    other cells instead, if possible.
    """

    def __init__(
        self, area: ExplorableArea, viewpoints: Viewpoints, reach: float, target: float, rng: np.random.Generator
    ) -> None:
        self.area, self.viewpoints = area, viewpoints
        self._reach = reach / area.walls.resolution
        self._rng = rng
        num_explorable = np.count_nonzero(area.explorable)
        self._num_allowed = num_explorable - math.ceil(target * num_explorable)
        self._misses = np.zeros(area.explorable.shape, dtype=np.int32)
        self._used = np.zeros(len(viewpoints.cells), dtype=bool)
        self._has_drifted = False
        self._samples = np.empty((0, 2), dtype=np.int64)
        self._sees = np.empty((len(viewpoints.cells), 0), dtype=np.uint64)
        self.stops: list[int] = []

    def leave_out(self, viewpoint: int) -> None:
        self._used[viewpoint] = True
        self._sees[viewpoint] = 0
        self.stops = [stop for stop in self.stops if stop != viewpoint]

    def use_up(self, viewpoint: int, seen: np.ndarray) -> None:
        """Remove a viewpoint after a visit or pass; record the visible cells that were not observed as missed."""
        missed = self._samples[unpack_bits(self._sees[viewpoint], len(self._samples))]
        missed = missed[~seen[tuple(missed.T)]]
        if viewpoint not in self.stops[:1]:
            missed = missed[np.hypot(*(missed - self.viewpoints.cells[viewpoint]).T) <= PASSED_SHARE * self._reach]
        self._misses[tuple(missed.T)] += 1
        self.leave_out(viewpoint)

    def plan(self, x: float, y: float, seen: np.ndarray, num_rounds: int) -> bool:
        """Plan the tour from (x, y), world frame [m]; return True if the tour observes the target fraction of the area.

        `seen`: mask of observed cells, shape of the explorable area, bool. `num_rounds`: rounds of improvement.
        """
        paths = self.viewpoints.paths_from(x, y)
        if paths is None:
            self.stops = []
            return False
        self._predecessors = paths[1]
        unseen = self.area.explorable & ~seen
        wanted = unseen & (self._misses < MAX_MISSES)
        num_wanted, num_allowed = int(np.count_nonzero(wanted)), self._num_allowed
        if not self._has_drifted:
            num_allowed -= int(np.count_nonzero(unseen)) - num_wanted
        if num_wanted <= num_allowed:
            self.stops = []
            return True
        known = self._sample(wanted)
        num_left = int(np.count_nonzero(~known)) * num_allowed // num_wanted if num_allowed > 0 else 0
        tour = np.array([len(self.viewpoints.cells), *self.stops], dtype=np.int64)
        cover, target = self._cover(*paths), len(known) - num_left
        tour, enough = search_tour(cover, pack_bits(known), target, tour, num_rounds, self._rng)
        self.stops = tour[1:].tolist()
        if enough and num_allowed >= 0:
            return True
        if self._has_drifted or self._misses.max() < MAX_MISSES:
            return False
        self._has_drifted = True
        return self.plan(x, y, seen, num_rounds)

    def next_viewpoint(self, x: float, y: float, distance: float) -> int:
        points, path = self.viewpoints.points, [self.stops[0]]
        while self._predecessors[path[0]] != len(points):
            path.insert(0, int(self._predecessors[path[0]]))
        here, travelled = np.array([x, y]), 0.0
        for viewpoint in path:
            travelled += math.hypot(*(points[viewpoint] - here))
            here = points[viewpoint]
            if travelled >= distance:
                return viewpoint
        return path[-1]

    def _sample(self, wanted: np.ndarray) -> np.ndarray:
        known: np.ndarray = ~wanted[tuple(self._samples.T)]
        num_left = np.count_nonzero(~known)
        if num_left > len(known) // 2 or (0 < len(known) < MAX_SAMPLES and num_left > 0):
            return known
        cells = np.argwhere(wanted)
        num_samples = min(len(cells), MAX_SAMPLES)
        self._samples = cells[np.sort(self._rng.choice(len(cells), num_samples, replace=False))]
        self._sees = views_from(self.area.walls.data == 0, self.viewpoints.cells, self._reach, self._samples)
        self._sees[self._used] = 0
        return np.zeros(num_samples, dtype=bool)

    def _cover(self, from_robot: np.ndarray, predecessors: np.ndarray) -> Cover:
        size = len(self.viewpoints.cells)
        lengths = np.pad(self.viewpoints.lengths, (0, 1))
        lengths[size, :size] = lengths[:size, size] = from_robot
        chain = np.pad(self.viewpoints.predecessors, (0, 1), constant_values=size)
        chain[size, :size] = predecessors
        return Cover(lengths + STOP_COST, chain, np.pad(self._sees, ((0, 1), (0, 0))))

"""Plans what is left of a place to see for a robot that knows the place: where to look from, in which order."""

import math

import numpy as np

from baselines.oracle.cover import Cover
from baselines.oracle.cover_places import Places
from baselines.oracle.cover_tour import search_tour
from baselines.oracle.cover_views import pack_bits, unpack_bits, views_from
from envs.worlds import ExplorableArea

MAX_SAMPLES = 8192
"""Most cells that stand for the area to see."""
STOP_COST = 0.1
"""What a stop costs beside the way to it [m]: of two tours of one length, that with fewer turns is driven faster."""

NEAR = 0.5
"""Cells within this share of the lidar's range are surely in sight of who passes a place closely."""
MAX_MISSES = 2
"""Stops, or places passed near to it, from which a cell should have been seen and was not, after which it had its
chance."""


class CoverPlanner:
    """Keeps a tour and what it is for; plans anew from wherever the robot is.

    A cell that was not seen from where it should have been had its chance: the tour does not go back for it, but makes
    up for it elsewhere. Where a map has drifted, cells lie behind its walls and never count as known. When so many were
    missed that the target cannot be reached without them, they are left to whoever comes after the tour.
    """

    def __init__(
        self, area: ExplorableArea, places: Places, reach: float, target_coverage: float, rng: np.random.Generator
    ) -> None:
        """Begin without a tour.

        Args:
            area: what there is to see.
            places: where to look from.
            reach: range of the lidar [m].
            target_coverage: share of the area to see.
            rng: source of chance.
        """
        self.area = area
        """What there is to see."""
        self.places = places
        self._reach = reach / area.walls.resolution
        self._rng = rng
        num_explorable = np.count_nonzero(area.explorable)
        self._num_allowed = num_explorable - math.ceil(target_coverage * num_explorable)
        self._misses = np.zeros(area.explorable.shape, dtype=np.int32)
        self._used = np.zeros(len(places.cells), dtype=bool)
        self._has_drifted = False
        self._samples = np.empty((0, 2), dtype=np.int64)
        self._sees = np.empty((len(places.cells), 0), dtype=np.uint64)
        self.stops: list[int] = []
        """Indices of the places to go to, in their order."""

    def leave_out(self, place: int) -> None:
        """Take note that no way leads to a place."""
        self._used[place] = True
        self._sees[place] = 0
        self.stops = [stop for stop in self.stops if stop != place]

    def use_up(self, place: int, seen: np.ndarray) -> None:
        """Take note that the robot has been at a place, and will see no more from there.

        Args:
            place: where it is: the next stop, or one that it passes by.
            seen: shape of the explorable area, bool: what is known now.
        """
        missed = self._samples[unpack_bits(self._sees[place], len(self._samples))]
        missed = missed[~seen[tuple(missed.T)]]
        if place not in self.stops[:1]:
            missed = missed[np.hypot(*(missed - self.places.cells[place]).T) <= NEAR * self._reach]
        self._misses[tuple(missed.T)] += 1
        self.leave_out(place)

    def plan(self, x: float, y: float, seen: np.ndarray, num_rounds: int) -> bool:
        """Update the tour.

        Args:
            x: position of the robot, world frame [m].
            y: position of the robot, world frame [m].
            seen: shape of the explorable area, bool: what is known already.
            num_rounds: how long to look for a shorter tour.

        Returns:
            Whether what there is to see suffices for the target coverage.
        """
        ways = self.places.ways_from(x, y)
        if ways is None:
            self.stops = []
            return False
        self._before = ways[1]
        unseen = self.area.explorable & ~seen
        wanted = unseen & (self._misses < MAX_MISSES)
        num_wanted, num_allowed = int(np.count_nonzero(wanted)), self._num_allowed
        if not self._has_drifted:
            num_allowed -= int(np.count_nonzero(unseen)) - num_wanted
        if num_wanted <= num_allowed:
            self.stops = []
            return True
        known = self._sample(wanted)
        # Samples stand for all that is wanted, and as large a share of them may be left out.
        num_left = int(np.count_nonzero(~known)) * num_allowed // num_wanted if num_allowed > 0 else 0
        tour = np.array([len(self.places.cells), *self.stops], dtype=np.int64)
        tour, enough = search_tour(
            self._cover(*ways), pack_bits(known), len(known) - num_left, tour, num_rounds, self._rng
        )
        self.stops = tour[1:].tolist()
        if enough and num_allowed >= 0:
            return True
        if self._has_drifted or self._misses.max() < MAX_MISSES:
            return False
        self._has_drifted = True
        return self.plan(x, y, seen, num_rounds)

    def next_places(self, x: float, y: float, distance: float) -> list[int]:
        """Return where to drive next: the stops within a distance along the tour, and the place on the way there.

        The ways between the stops that the tour counts on may not be the shortest by a hair; whoever heads for a place
        that is near enough takes them nevertheless.

        Args:
            x: position of the robot, world frame [m].
            y: position of the robot, world frame [m].
            distance: how far to look ahead [m].
        """
        places: list[int] = []
        here, points, travelled = np.array([x, y]), self.places.points, 0.0
        origin, before = len(points), self._before
        for stop in self.stops:
            way = [stop]
            while before[way[-1]] != origin:
                way.append(int(before[way[-1]]))
            for place in reversed(way):
                travelled += math.hypot(*(points[place] - here))
                here = points[place]
                if travelled >= distance:
                    return [*places, place]
            places.append(stop)
            origin, before = stop, self.places.before[stop]
        return places

    def _sample(self, wanted: np.ndarray) -> np.ndarray:
        """Return which samples need not be seen, shape (s,), bool; draws new ones when few of them are left.

        Args:
            wanted: shape of the explorable area, bool: what is to be seen.
        """
        known: np.ndarray = ~wanted[tuple(self._samples.T)]
        num_left = np.count_nonzero(~known)
        if num_left > len(known) // 2 or (0 < len(known) < MAX_SAMPLES and num_left > 0):
            return known
        cells = np.argwhere(wanted)
        num_samples = min(len(cells), MAX_SAMPLES)
        self._samples = cells[np.sort(self._rng.choice(len(cells), num_samples, replace=False))]
        self._sees = views_from(self.area.walls.data == 0, self.places.cells, self._reach, self._samples)
        self._sees[self._used] = 0
        return np.zeros(num_samples, dtype=bool)

    def _cover(self, ways: np.ndarray, before: np.ndarray) -> Cover:
        """Return the places with the robot as the last one of them."""
        size = len(self.places.cells)
        lengths = np.zeros((size + 1, size + 1))
        lengths[:size, :size] = self.places.lengths
        lengths[size, :size] = lengths[:size, size] = ways
        lengths += STOP_COST
        # Nothing leads back to the robot.
        chain = np.full((size + 1, size + 1), size, dtype=np.int32)
        chain[:size, :size] = self.places.before
        chain[size, :size] = before
        # A place that is used up is nobody's neighbour, so that no stop is moved there.
        near = np.zeros((size + 1, self.places.near.shape[1]), dtype=np.int32)
        near[:size] = np.where(self._used[self.places.near], np.arange(size)[:, None], self.places.near)
        sees = np.concatenate([self._sees, np.zeros((1, self._sees.shape[1]), dtype=np.uint64)])
        return Cover(lengths, chain, near, sees)

"""Plans what is left of a place to see for a robot that knows the place: where to look from, in which order."""

import math

import numpy as np

from baselines.cover import Cover
from baselines.cover_places import Places
from baselines.cover_tour import search_tour
from baselines.cover_views import pack_bits, unpack_bits, views_from
from envs.coverage import ExplorableArea

MAX_SAMPLES = 8192
"""Most cells that stand for the area to see."""
STOP_COST = 0.1
"""What a stop costs beside the way to it [m]: of two tours of one length, that with fewer turns is driven faster."""

MAX_MISSES = 3
"""Places from which a sample should have been seen and was not, after which it is given up: a map that has drifted shows
walls in its stead."""


class CoverPlanner:
    """Keeps a tour and what it is for; plans anew from wherever the robot is."""

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
        self._misses = np.zeros(area.explorable.shape, dtype=np.uint8)
        self._used = np.zeros(len(places.cells), dtype=bool)
        self._num_fresh = 0
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
            place: where it is.
            seen: shape of the explorable area, bool: what is known now.
        """
        missed = self._samples[unpack_bits(self._sees[place], len(self._samples))]
        missed = missed[~seen[tuple(missed.T)]]
        self._misses[tuple(missed.T)] += 1
        self._sees &= ~pack_bits(self._misses[tuple(self._samples.T)] >= MAX_MISSES)
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
        num_unseen = int(np.count_nonzero(self.area.explorable & ~seen))
        if ways is None or num_unseen <= self._num_allowed:
            self.stops = []
            return ways is not None
        known = self._sample(seen)
        # Samples stand for all that has not been seen, and as large a share of them may be left out.
        num_allowed = int(np.count_nonzero(~known) * self._num_allowed / num_unseen)
        tour = np.array([len(self.places.cells), *self.stops], dtype=np.int64)
        tour, enough = search_tour(
            self._cover(*ways), pack_bits(known), len(known) - num_allowed, tour, num_rounds, self._rng
        )
        self.stops = tour[1:].tolist()
        return bool(enough)

    def _sample(self, seen: np.ndarray) -> np.ndarray:
        """Return which samples are known, shape (s,), bool; draws new ones when few of them are not."""
        if self._num_fresh:
            known: np.ndarray = seen[tuple(self._samples.T)]
            if np.count_nonzero(~known) > self._num_fresh // 2 or self._num_fresh < MAX_SAMPLES:
                return known
        unseen = np.argwhere(self.area.explorable & ~seen & (self._misses < MAX_MISSES))
        self._num_fresh = min(len(unseen), MAX_SAMPLES)
        self._samples = unseen[np.sort(self._rng.choice(len(unseen), self._num_fresh, replace=False))]
        free = self.area.walls.data == 0
        self._sees = views_from(free, self.places.cells, self._reach, self._samples)
        self._sees[self._used] = 0
        return np.zeros(self._num_fresh, dtype=bool)

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

"""Memory of a robot that explores: frontiers, and people on its way."""

import numpy as np

from lidarnaut.envs.estimation import Belief, Correction
from lidarnaut.envs.navigation.maps.obstacles import NO_POINTS

RETRY_RADIUS = 0.5
"""A frontier within this distance of an earlier frontier takes over its age and number of failed drives [m]."""
WALKING_SPEED = 0.2
MET_CELL = 0.3
"""Grid spacing for storing positions where people were seen, one per cell [m]."""


class FrontierMemory:
    """Memory of three sets of frontiers, map frame: known ones, ones not reached, and ignored ones."""

    def __init__(self) -> None:
        self.known = np.empty((0, 3))
        """Known frontiers (x, y) and times of their first appearance, shape (n, 3) [m, m, s]."""
        self.failures = NO_POINTS
        """Frontiers of failed drives, shape (n, 2) [m]."""
        self.given_up = NO_POINTS
        """Centres of ignored frontier cells, shape (n, 2) [m]."""
        self.num_looks = 0
        """Number of times that ignored frontiers were offered again."""

    def add_failure(self, target: tuple[float, float]) -> int:
        """Store a failed drive, and return the number of those to the same frontier."""
        self.failures = np.vstack([self.failures, target])
        return int(np.count_nonzero(np.hypot(*(self.failures - target).T) <= RETRY_RADIUS))

    def correct(self, correction: Correction) -> None:
        """Move the positions with the map; ignored cells stay."""
        self.failures = correction.apply(self.failures)
        self.known[:, :2] = correction.apply(self.known[:, :2])


class PeopleNearby:
    """Walking people near the robot, and positions of people met before."""

    def __init__(self) -> None:
        self._walking = np.empty((0, 5))
        self._met: dict[tuple[int, int], tuple[float, float]] = {}

    def update(self, belief: Belief) -> None:
        people = self._walking = belief.people
        if len(people) == 0:
            return
        self._walking = people[np.hypot(people[:, 2], people[:, 3]) > WALKING_SPEED]
        for x, y in belief.pose.transform(people[:, :2]).tolist():
            self._met[round(x / MET_CELL), round(y / MET_CELL)] = x, y

    @property
    def met(self) -> np.ndarray:
        """Positions of people met before, shape (n, 2), map frame [m]."""
        return np.array(list(self._met.values())).reshape(-1, 2)

    def without_walking(self, obstacles: np.ndarray) -> np.ndarray:
        """Return the obstacle points, shape (n, 2), outside walking people: shape (k, 2), base frame [m]."""
        for x, y, _, _, radius in self._walking.tolist():
            obstacles = obstacles[np.hypot(obstacles[:, 0] - x, obstacles[:, 1] - y) > radius + 0.1]
        return obstacles

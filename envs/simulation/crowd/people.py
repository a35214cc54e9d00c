"""The people of an episode, as arrays that kernels step."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from envs.geometry import Pose2D
from envs.worlds import World

from . import records as at
from .params import Crowd


class CrowdSetup(NamedTuple):
    """What kernels read of a crowd, all of it float."""

    orca: float = 0.0
    """1 for ORCA, 0 for the social force model."""
    legs: float = 0.0
    """1 where lidars see legs, 0 where they see discs."""
    strength: float = 7.0
    """See `Crowd.strength` [m/s2]."""


class People:
    """The people in a world: those on its fixed routes, and after them a crowd that is drawn for each episode."""

    def __init__(self, crowd: Crowd | None = None) -> None:
        """Prepare for a crowd; None for nobody but those on fixed routes."""
        self.crowd = crowd
        self.rows = np.empty((0, at.PERSON_SIZE))
        """Shape (n, PERSON_SIZE), float64; see `records`."""
        self.points = np.empty((0, 3))
        """Shape (k, 3), float64: points to walk to (x, y), world frame [m], and the row of the one after it on a fixed
        route."""
        self.fields = np.empty((0, 0, 0), dtype=np.float32)
        """Shape (k, height, width), float32: cost-to-go to the points that a crowd walks to [m]."""
        self.setup = np.zeros(len(CrowdSetup._fields))
        """`CrowdSetup` as an array."""

    def reset(self, world: World, poses: Sequence[Pose2D], radius: float, rng: np.random.Generator | None) -> None:
        """Begin an episode.

        `poses`, `radius`: where robots start, world frame, and how large they are [m]; `rng`: draws the crowd, None
        without one.

        Raises:
            ValueError: there is no room for all people.
        """
        routes = world.people
        self.rows = np.zeros((len(routes), at.PERSON_SIZE))
        points: list[np.ndarray] = [np.empty((0, 3))]
        first = 0
        for row, route in zip(self.rows, routes, strict=True):
            count = len(route.waypoints)
            row[[at.X, at.Y]] = row[[at.BEFORE_X, at.BEFORE_Y]] = route.waypoints[0]
            row[at.RADIUS], row[at.SPEED], row[at.KIND], row[at.GOAL] = (
                route.radius,
                route.speed,
                at.FIXED_ROUTE,
                first + 1,
            )
            following = first + np.roll(np.arange(count), -1)
            points.append(np.column_stack([route.waypoints, following]))
            first += count
        self.points = np.vstack(points)

    @property
    def arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """What kernels take: rows, points, fields, setup."""
        return self.rows, self.points, self.fields, self.setup

    @property
    def states(self) -> np.ndarray:
        """Shape (n, 5), float64: x, y, radius [m], vx, vy [m/s], world frame."""
        return self.rows[:, [at.X, at.Y, at.RADIUS, at.VX, at.VY]]

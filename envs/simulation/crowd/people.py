"""The people of an episode, as arrays that kernels step."""

from collections.abc import Sequence

import numpy as np

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.worlds import World

from . import records as at
from .params import Crowd
from .placement import draw_people
from .routes import plan_routes


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
        self.setup = np.zeros(at.WALLS)
        """Shape (k,), float64: numbers of the model and of the walls; see `records`."""

    def reset(self, world: World, poses: Sequence[Pose2D], radius: float, rng: np.random.Generator | None) -> None:
        """Begin an episode.

        `poses`, `radius`: where robots start, world frame, and how large they are [m]; `rng`: draws the crowd, None
        without one.

        Raises:
            ValueError: there is no room for all people.
        """
        routes = world.people
        self.rows = np.zeros((len(routes), at.PERSON_SIZE))
        self.points = np.empty((0, 3))
        for row, route in zip(self.rows, routes, strict=True):
            first = len(self.points)
            row[[at.X, at.Y]] = route.waypoints[0]
            row[[at.RADIUS, at.SPEED, at.KIND, at.GOAL]] = route.radius, route.speed, at.FIXED_ROUTE, first + 1
            following = first + np.roll(np.arange(len(route.waypoints)), -1)
            self.points = np.vstack([self.points, np.column_stack([route.waypoints, following])])
        if self.crowd is not None and rng is not None:
            self._draw(self.crowd, world, poses, radius, rng)

    def _draw(
        self, crowd: Crowd, world: World, poses: Sequence[Pose2D], radius: float, rng: np.random.Generator
    ) -> None:
        """Add a crowd to the people on fixed routes."""
        routes, first = plan_routes(world, crowd.radius[1], crowd.flow), len(self.points)
        people = draw_people(crowd, routes, poses, radius, self.rows, rng, world)
        people[:, at.GOAL] += first
        points = routes.points.copy()
        points[points[:, 2] >= 0.0, 2] += first
        self.rows, self.points = np.vstack([self.rows, people]), np.vstack([self.points, points])
        self.fields, walls = routes.fields, routes.walls
        numbers = [crowd.model == "orca", crowd.body == "legs", *walls.grid]
        model: tuple[float, ...] = crowd.orca if crowd.model == "orca" else crowd.forces
        self.setup = np.concatenate([np.resize([*numbers, *model], at.WALLS), walls.near])

    @property
    def arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """What kernels take: rows, points, fields, setup."""
        return self.rows, self.points, self.fields, self.setup

    @property
    def states(self) -> np.ndarray:
        """Shape (n, 5), float64: x, y, radius [m], vx, vy [m/s], world frame."""
        return self.rows[:, [at.X, at.Y, at.RADIUS, at.VX, at.VY]]

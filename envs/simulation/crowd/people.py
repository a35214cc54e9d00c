"""States of the simulated people in an episode, stored in arrays."""

from collections.abc import Sequence

import numpy as np

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.worlds import World

from . import person_row as at
from .crowd_params import Crowd
from .placement import draw_people
from .routes import plan_routes


class People:
    """Simulated people of an episode: first those on fixed routes of the world, then a randomly placed crowd."""

    def __init__(self, crowd: Crowd | None = None) -> None:
        self.crowd = crowd
        self.rows = np.empty((0, at.PERSON_SIZE))
        """State vectors of the people, shape (n, PERSON_SIZE), float64; columns: see module `person_row`."""
        self.points = np.empty((0, 3))
        """Destinations, shape (k, 3), float64: x, y in the world frame [m], and index of the next destination or -1
        (random)."""
        self.fields = np.empty((0, 0, 0), dtype=np.float32)
        """Cost-to-go from each grid cell to each destination of the crowd, shape (k, height, width), float32 [m]."""
        self.setup = np.zeros(at.WALLS)
        """Parameters of the pedestrian model, and static obstacles, packed into one array, shape (k,), float64."""

    def reset(self, world: World, poses: Sequence[Pose2D], radius: float, rng: np.random.Generator | None) -> None:
        """Place people at the start of an episode.

        `poses`: start poses of the robots, world frame. `radius`: footprint radius of a robot [m]. `rng`: random
        generator of the crowd. ValueError if not all people fit into the world.
        """
        self.rows = np.zeros((len(world.people), at.PERSON_SIZE))
        self.points = np.empty((0, 3))
        for row, route in zip(self.rows, world.people, strict=True):
            first = len(self.points)
            row[[at.X, at.Y]] = route.waypoints[0]
            row[[at.RADIUS, at.SPEED, at.KIND, at.GOAL]] = route.radius, route.speed, at.FIXED_ROUTE, first + 1
            following = first + np.roll(np.arange(len(route.waypoints)), -1)
            self.points = np.vstack([self.points, np.column_stack([route.waypoints, following])])
        if (crowd := self.crowd) is None or rng is None:
            return
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
        return self.rows, self.points, self.fields, self.setup

    @property
    def states(self) -> np.ndarray:
        """States of people, shape (n, 5), float64: x, y, radius [m], vx, vy [m/s], world frame."""
        return self.rows[:, [at.X, at.Y, at.RADIUS, at.VX, at.VY]]

"""Start positions and states of the simulated people in an episode, stored in arrays."""

import math
from collections.abc import Sequence

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.worlds import World

from . import person_row as at
from .crowd_params import Crowd
from .routes import RESOLUTION, Routes, plan_routes
from .walls import clearance

ROBOT_GAP = 1.0
"""Minimum gap between a person and a robot at the start [m]."""
PEOPLE_GAP = 0.05
"""Minimum gap between two people at the start [m]."""


class People:
    """Simulated people of an episode: first those on fixed routes of the world, then a randomly placed crowd."""

    def __init__(self, crowd: Crowd | None = None) -> None:
        self.params = crowd
        """Parameters of the crowd, or None."""
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
        if (crowd := self.params) is None or rng is None:
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
        """States of people, shape (n, 5), float64: x, y [m], vx, vy [m/s], radius [m], world frame."""
        return self.rows[:, : at.RADIUS + 1].copy()


def draw_people(
    crowd: Crowd,
    routes: Routes,
    robots: Sequence[Pose2D],
    robot_radius: float,
    others: np.ndarray,
    rng: np.random.Generator,
    world: World,
) -> np.ndarray:
    """Sample people at rest in free space, and return their state vectors, shape (n, PERSON_SIZE).

    `robots`: start poses, world frame. `robot_radius`: footprint radius [m]. `others`: state vectors of people on fixed
    routes. ValueError if not all people fit into the world.
    """
    low, high = crowd.number if isinstance(crowd.number, tuple) else (crowd.number, crowd.number)
    count = int(rng.integers(low, high, endpoint=True))
    rows = np.zeros((count, at.PERSON_SIZE))
    rows[:, at.RADIUS] = rng.uniform(*crowd.radius, count)
    rows[:, at.SPEED] = rng.uniform(*crowd.speed, count)
    stands, sees = rng.random((2, count))
    rows[:, at.KIND] = np.where(sees < crowd.attentive, at.ATTENTIVE, at.BLIND)
    rows[stands < crowd.standing, at.KIND] = at.STANDING
    rows[:, at.GOAL] = rng.integers(len(routes.points), size=count)
    rows[:, at.HEADING] = rng.uniform(-math.pi, math.pi, count)
    rows[:, at.DRAWS :] = rng.random((count, at.NUM_DRAWS))
    taken = np.zeros((len(robots) + len(others) + count, 3))
    for k, (x, y, _) in enumerate(robots):
        taken[k] = x, y, robot_radius + ROBOT_GAP - PEOPLE_GAP
    taken[len(robots) :] = np.concatenate([others, rows])[:, [at.X, at.Y, at.RADIUS]]
    first, cells, placed = len(taken) - count, np.arange(len(routes.room)), 0
    for tries in (rng.integers(len(cells), size=32 * count), rng.permutation(cells)):
        shifts = RESOLUTION * (rng.random((len(tries), 2)) - 0.5)
        placed += _fill(taken, first + placed, routes.room[tries] + shifts, routes.walls)
        if placed == count:
            break
    else:
        asked = f"{placed} of {count} people of a radius of {crowd.radius[1]:g} m, at least {ROBOT_GAP:g} m from robots"
        raise ValueError(f"world {world.name!r} has room for {asked}; use fewer people or a larger world")
    rows[:, [at.X, at.Y]] = taken[first:, :2]
    return rows


@njit(cache=True, error_model="numpy")
def _fill(taken, first, tries, walls):
    row, (near, grid) = first, walls
    for k in range(tries.shape[0]):
        if row == taken.shape[0]:
            break
        x, y = tries[k]
        radius = taken[row, 2]
        has_room = clearance(near, grid, x, y) > radius
        for j in range(row):
            has_room &= math.hypot(x - taken[j, 0], y - taken[j, 1]) > radius + taken[j, 2] + PEOPLE_GAP
        if has_room:
            taken[row, 0], taken[row, 1] = x, y
            row += 1
    return row - first

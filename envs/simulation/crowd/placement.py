"""Start positions of a crowd."""

import math
from collections.abc import Sequence

import numpy as np
from numba import njit

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.worlds import World

from . import person_row as at
from .crowd_params import Crowd
from .routes import RESOLUTION, Routes
from .walls import clearance

ROBOT_GAP = 1.0
"""Minimum gap between a person and a robot at the start [m]."""
PEOPLE_GAP = 0.05
"""Minimum gap between two people at the start [m]."""


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
        raise ValueError(
            f"world {world.name!r} has room for {placed} of {count} people of a radius of {crowd.radius[1]:g} m, "
            f"at least {ROBOT_GAP:g} m from robots; use fewer people or a larger world"
        )
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

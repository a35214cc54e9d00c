"""Known worlds with the maps that robots localize on."""

import math
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from benchmarks.recorded_drives import RESOLUTION, Drive, Setup, make_setup, record
from envs.arguments import choose_robot
from envs.geometry import FREE, OCCUPIED, UNKNOWN, OccupancyGrid, Pose2D
from envs.worlds import load_world


class KnownWorld(NamedTuple):
    """A world with its usual robot and its map."""

    setup: Setup
    grid: OccupancyGrid
    """The map: obstacles are occupied, what the robot can see is free, all else unknown."""


@lru_cache(maxsize=4)
def load_known_world(name: str, physics: str = "kinematic") -> KnownWorld:
    """Load a library world and make its map.

    Walls of library worlds tend to lie on the border between cells, which would move all of them half a cell up and
    right: the raster is shifted so that the outer walls run through the middle of cells.
    """
    world, robot = load_world(name), choose_robot(None, name)
    half = 0.5 * RESOLUTION
    x_min, y_min, x_max, y_max = world.bounds
    world = replace(world, bounds=(x_min - half, y_min - half, x_max + half, y_max + half))
    setup = make_setup(world, robot, physics)
    walls = setup.area.walls
    data = walls.data.copy()
    data[(data == FREE) & ~setup.area.explorable] = UNKNOWN
    return KnownWorld(setup, OccupancyGrid(data, RESOLUTION, walls.origin))


def record_from_anywhere(setup: Setup, seed: np.random.SeedSequence, duration: float) -> Drive:
    """Drive a robot to random goals from a random start for `duration` [s]."""
    rng_simulator, rng_driver = (np.random.default_rng(child) for child in seed.spawn(2))
    return record(setup, setup.area.draw_pose(rng_driver), rng_simulator, rng_driver, duration)


def symmetries(grid: OccupancyGrid, share: float = 0.9) -> list[Pose2D]:
    """Find the turns by multiples of 30 degrees about the middle of the free space that lay a map over itself.

    At least a `share` of its occupied cells must come to lie within two cells of another one. Returns the motions, in
    the map frame.
    """
    occupied, free = grid.data == OCCUPIED, grid.data == FREE
    distances = ndimage.distance_transform_edt(~occupied)
    points = grid.centers(np.argwhere(occupied))
    middle = grid.centers(np.argwhere(free)).mean(axis=0)
    found = []
    for k in range(1, 12):
        turn = Pose2D(0.0, 0.0, math.radians(30.0 * k))
        shift = middle - turn.transform(middle[None])[0]
        motion = Pose2D(float(shift[0]), float(shift[1]), turn.theta)
        cells = grid.cells(motion.transform(points))
        inside = grid.contains(cells)
        near = distances[tuple(cells[inside].T)] <= 2.0
        if np.count_nonzero(near) >= share * len(points):
            found.append(motion)
    return found

"""Drives through known places, recorded once and localised along as often as needed."""

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy import ndimage

from benchmarks.slam_drive import Errands
from envs.coverage import ExplorableArea, explorable_area
from envs.geometry import FREE, OCCUPIED, UNKNOWN, OccupancyGrid, Pose2D
from envs.robot_env import choose_robot
from envs.robots import RobotParams, WheelOdometry
from envs.simulation import make_simulator
from envs.worlds import World, load_world

RESOLUTION = 0.05
"""Side of a map cell [m]."""
PERIOD = 0.1
"""Time between two commands and scans [s]."""


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """A world, the robot that is usual there, and the map that it is given."""

    world: World
    """Where."""
    robot: RobotParams
    """Who."""
    area: ExplorableArea
    """Where it can be."""
    grid: OccupancyGrid
    """The map: what is touched is occupied, what the robot could see is free, all else unknown."""


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """What a robot recorded, and the truth."""

    ranges: np.ndarray
    """Shape (n, num_beams), float32 [m]."""
    motions: np.ndarray
    """Shape (n, 3), float64: the base by odometry, seen from the base one scan before [m, rad]; 0 at the start."""
    truth: np.ndarray
    """Shape (n, 3), float64: true poses, world frame [m, rad]."""

    def then(self, other: "Drive", scans: int) -> "Drive":
        """Return a drive whose robot is carried off unseen after some scans, and goes on as another drive does."""
        return Drive(
            np.concatenate([self.ranges[:scans], other.ranges]),
            np.concatenate([self.motions[:scans], other.motions]),
            np.concatenate([self.truth[:scans], other.truth]),
        )


@lru_cache(maxsize=4)
def load_place(name: str) -> Place:
    """Load a world and make its map.

    Walls of library worlds like to lie where cells would meet, which would move all of them half a cell up and right:
    the raster is laid so that what bounds the world runs through the middle of cells.
    """
    world, robot = load_world(name), choose_robot(None, name)
    half = 0.5 * RESOLUTION
    x_min, y_min, x_max, y_max = world.bounds
    world = replace(world, bounds=(x_min - half, y_min - half, x_max + half, y_max + half))
    area = explorable_area(world, robot, RESOLUTION)
    data = area.walls.data.copy()
    data[(data == FREE) & ~area.explorable] = UNKNOWN
    return Place(world, robot, area, OccupancyGrid(data, RESOLUTION, area.walls.origin))


def record(place: Place, seed: np.random.SeedSequence, duration: float, physics: str) -> Drive:
    """Send a robot on errands from a random start.

    Args:
        place: where.
        seed: of everything random.
        duration: length of the drive [s].
        physics: by which physics.
    """
    rng_simulator, rng_driver = (np.random.default_rng(child) for child in seed.spawn(2))
    driver = Errands(place.robot, place.area, rng_driver)
    simulator = make_simulator(physics, place.robot, PERIOD)
    reading = simulator.reset(place.world, [place.area.draw_pose(rng_driver)], [rng_simulator])[0]
    wheels = WheelOdometry(place.robot)
    wheels.reset(reading.ticks)
    ranges, motions, truth = [reading.ranges], [Pose2D(0.0, 0.0, 0.0)], [simulator.states[0].pose]
    for _ in range(round(duration / PERIOD)):
        reading = simulator.step([driver.act(truth[-1])])[0]
        ranges.append(reading.ranges)
        motions.append(wheels.update(reading.ticks))
        truth.append(simulator.states[0].pose)
    simulator.close()
    return Drive(np.array(ranges), np.array(motions), np.array(truth))


def symmetries(grid: OccupancyGrid, share: float = 0.9) -> list[Pose2D]:
    """Find the turns by multiples of 30 degrees about the middle of the free space that lay a map over itself.

    Args:
        grid: the map.
        share: of its occupied cells that must come to lie within two cells of another one.

    Returns:
        The motions, in the map frame.
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

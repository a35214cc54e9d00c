"""Random exploration tasks for training, without held-out (test) worlds and robots."""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from lidarnaut.envs.decisions.abstract import ExploreFrontiersAbstractEnv
from lidarnaut.envs.files import read_record
from lidarnaut.envs.robots import ROBOT_NAMES, RobotParams, load_robot
from lidarnaut.envs.worlds import FAMILIES, WORLD_NAMES, World, explorable_area, load_world

TARGET = 0.95
"""Explored fraction that ends an episode."""
LIBRARY_SHARE = 0.3
"""Fraction of tasks in worlds of the library; the remaining worlds are generated."""
SIDES = {
    "rooms": (7.0, 26.0),
    "maze": (6.0, 16.0),
    "warehouse": (12.0, 36.0),
    "caves": (8.0, 24.0),
    "wings": (10.0, 36.0),
    "halls": (5.0, 28.0),
}
"""Range of side lengths of generated worlds [m], by family; sampled log-uniformly."""
RANGES = (3.5, 5.0, 8.0, 12.0, 20.0)
"""Maximum ranges of the lidar on randomized robots [m]."""
LEAST_AREA = 8.0
"""Minimum explorable area of a world, divided by the lidar range, or by 8 m for longer ranges [m2/m]."""
RESOLUTIONS = (0.1, 0.15, 0.2)
"""Map cell sides [m] of random tasks; the smallest only occurs in worlds below 200 m2."""


@dataclass(frozen=True, slots=True)
class HeldOut:
    """Library worlds and robots excluded from training."""

    worlds: tuple[str, ...]
    robots: tuple[str, ...]


HELD_OUT = read_record(Path(__file__).with_name("held_out.yaml"), HeldOut)
TRAINING_WORLDS = tuple(name for name in WORLD_NAMES if name not in HELD_OUT.worlds)
TRAINING_ROBOTS = tuple(name for name in ROBOT_NAMES if name not in HELD_OUT.robots)


def is_held_out(world: str, robot: str) -> bool:
    """Return True if the robot or the world was excluded from training. Generated worlds count as excluded."""
    return world not in TRAINING_WORLDS or robot in HELD_OUT.robots


SPLIT = {
    "training_worlds": list(TRAINING_WORLDS),
    "held_out_worlds": list(HELD_OUT.worlds),
    "held_out_robots": list(HELD_OUT.robots),
}
"""Names of training worlds, held-out worlds and held-out robots, recorded with saved policies."""


@dataclass(frozen=True, slots=True)
class ExplorationTask:
    """Settings of an exploration episode: world, robot, map and seeds."""

    world: str
    """Name of a library world, or family of generated worlds."""
    world_seed: int
    """Seed of a generated world; training uses even seeds."""
    size: tuple[float, float]
    """Outer width and height of a generated world [m]."""
    robot: RobotParams
    resolution: float
    """Side of a map cell [m]."""
    drift: float
    """Standard deviation of the estimated position's error [m]; for the heading, a sixth of this value [rad]."""
    seed: int
    """Seed of start pose and noise."""


def draw_task(rng: np.random.Generator, families: tuple[str, ...] = tuple(SIDES)) -> ExplorationTask:
    """Draw a random task whose robot fits into the world, with sufficient explorable area."""
    while True:
        task = _draw(rng, families)
        try:
            area = explorable_area(make_world(task), task.robot, task.resolution).area
        except ValueError:
            continue
        if area >= LEAST_AREA * min(task.robot.lidar.range_max, 8.0):
            return task


def training_world(rng: np.random.Generator) -> World:
    """Return a random training world, from the library or generated; for the configuration key `environment.world`."""
    if rng.random() < LIBRARY_SHARE:
        return load_world(str(rng.choice(TRAINING_WORLDS)))
    return FAMILIES[str(rng.choice(tuple(SIDES)))](2 * int(rng.integers(2**30)))


def validation_world(rng: np.random.Generator) -> World:
    """Return a generated test world of default size; for the configuration key `evaluation.environment.world`."""
    return FAMILIES[str(rng.choice(tuple(SIDES)))](2 * int(rng.integers(2**30)) + 1)


def sized_training_world(rng: np.random.Generator) -> World:
    """Return a generated training world of random size; for the configuration key `environment.world`."""
    family = str(rng.choice(tuple(SIDES)))
    return FAMILIES[family](2 * int(rng.integers(2**30)), _draw_size(rng, family))


def _draw_size(rng: np.random.Generator, family: str) -> tuple[float, float]:
    low, high = SIDES[family]
    width, height = np.exp(rng.uniform(math.log(low), math.log(high), 2)).tolist()
    return width, height


def _draw(rng: np.random.Generator, families: tuple[str, ...]) -> ExplorationTask:
    if not families or rng.random() < LIBRARY_SHARE:
        world, size = str(rng.choice(TRAINING_WORLDS)), (0.0, 0.0)
    else:
        world = str(rng.choice(families))
        size = _draw_size(rng, world)
    is_family = world in FAMILIES
    robot = draw_robot(rng, 0.24 if is_family else 0.16)
    area = size[0] * size[1] if is_family else 150.0
    resolution = float(rng.choice(RESOLUTIONS if area < 200.0 else RESOLUTIONS[1:]))
    seeds, drift = rng.integers(2**30, size=2), float(rng.uniform(0.0, 0.05))
    return ExplorationTask(world, 2 * int(seeds[0]), size, robot, resolution, drift, int(seeds[1]))


def draw_robot(rng: np.random.Generator, max_radius: float) -> RobotParams:
    """Return a random library robot or variant, with a footprint radius up to `max_radius` [m]."""
    fitting = [robot for robot in map(load_robot, TRAINING_ROBOTS) if robot.radius <= max_radius]
    robot = fitting[int(rng.integers(len(fitting)))]
    if rng.random() < 0.5:
        return replace(robot, lidar=replace(robot.lidar, num_beams=min(robot.lidar.num_beams, 240)))
    lidar = replace(robot.lidar, range_max=float(rng.choice(RANGES)), num_beams=min(robot.lidar.num_beams, 240))
    radius, speed = float(rng.uniform(0.08, max_radius)), float(math.exp(rng.uniform(math.log(0.2), math.log(0.8))))
    return replace(robot, name="drawn", lidar=lidar, radius=radius, max_v=speed)


def make_world(task: ExplorationTask) -> World:
    """Load or generate the world of a task."""
    if task.world in FAMILIES:
        # Wider passages compensate for coarse cells.
        return FAMILIES[task.world](task.world_seed, task.size, task.robot.radius + 0.5 * task.resolution)
    return load_world(task.world)


@lru_cache(maxsize=4)
def make_environment(robot: RobotParams, resolution: float, drift: float) -> ExploreFrontiersAbstractEnv:
    """Return an exploration environment without simulated driving, cached for the last four argument combinations.

    `resolution`: side of a map cell [m]. `drift`: standard deviation of the estimated position's error [m].
    """
    return ExploreFrontiersAbstractEnv(
        robot=robot, map_resolution=resolution, drift=(drift, drift / 6.0), target_coverage=TARGET, world="rooms"
    )

"""Large maps of shapes that are hard to work on: what the first reset in a new process takes."""

import math
import resource
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import gymnasium
import numpy as np
from numpy.random import Generator

from envs.geometry import OccupancyGrid
from envs.progress import Progress
from envs.robots import load_robot
from envs.worlds import save_map

from . import Report, call_elsewhere

Cells = np.ndarray
CASES = {
    "Explore-v0, kinematic, truth": ("Explore", {"physics": "kinematic", "slam": "truth"}),
    "Explore-v0": ("Explore", {}),
    "ExploreFrontiers-v0": ("ExploreFrontiers", {}),
    "Navigate-v0": ("Navigate", {}),
}
"""Ids and arguments; bullet and the usual SLAM where none are given."""
RESOLUTION = 0.05
"""Side of a map cell [m]."""
MOST_TIME, MOST_MEMORY = 10.0, 4.0
"""What a reset may take: processor time [s], and memory of the process [GiB]."""


# Free cells by row and column, of a square map of `size` cells. `fit` is the width of the narrowest passage that the
# robot fits through [cells].


def maze(y: Cells, x: Cells, size: int, fit: int, rng: Generator) -> Cells:
    """Every cell of a lattice is joined to the one above it or to the one beside it, at random."""
    period = fit + 2
    upwards = rng.random((size, size)) < 0.5
    upwards[:, 0], upwards[0] = True, False
    joined = upwards[y // period, x // period]
    along_y, along_x = y % period >= 2, x % period >= 2
    return (along_y & along_x) | (along_x & ~along_y & joined) | (along_y & ~along_x & ~joined)


def rooms(y: Cells, x: Cells, size: int, fit: int, rng: Generator) -> Cells:
    """Rooms of 40 cells with a door in each wall."""
    in_y, in_x = y % 42 >= 2, x % 42 >= 2
    door_y, door_x = abs(y % 42 - 22) < fit / 2, abs(x % 42 - 22) < fit / 2
    return (in_y & in_x) | (in_y & door_y) | (in_x & door_x)


def closets(y: Cells, x: Cells, size: int, fit: int, rng: Generator, pillars: float = 0.0) -> Cells:
    """Corridors from one hall, along rooms of 60 cells with a door that is too narrow, and pillars of one cell."""
    wide = fit + 2
    v, u = y % (wide + 64), x % 62
    room = (v >= wide + 2) & (v < wide + 62) & (u >= 2) & (rng.random((size, size)) >= pillars)
    door = (v >= wide) & (v < wide + 2) & (u >= 30) & (u < 29 + fit)
    hall = (x < 100) & (abs(y - size // 2) < 50)
    return (v < wide) | (x < wide) | room | door | hall


def rings(y: Cells, x: Cells, size: int, fit: int, rng: Generator) -> Cells:
    """Square corridors around each other, joined to the left and to the right by turns."""
    depth = np.minimum(np.minimum(x, y), np.minimum(size - 1 - x, size - 1 - y))
    ring = depth // (fit + 2)
    gap = (abs(y - size // 2) < fit) & ((x < size // 2) == (ring % 2 == 0))
    return (depth % (fit + 2) >= 2) | gap


def noise(y: Cells, x: Cells, size: int, fit: int, rng: Generator, share: float = 0.1) -> Cells:
    """Single occupied cells, around a hall in the middle."""
    return (rng.random((size, size)) >= share) | (np.maximum(abs(y - size // 2), abs(x - size // 2)) < 20)


def wider(shape: Callable[..., Cells], more: int) -> Callable[..., Cells]:
    """Return a shape whose passages are `more` cells wider than what the robot fits through."""
    return lambda y, x, size, fit, rng: shape(y, x, size, fit + more, rng)


MAPS: dict[str, Callable[..., Cells]] = {
    **{f"maze, corridors {more:+d}": wider(maze, more) for more in (-1, 0, 1)},
    **{f"rooms, doors {more:+d}": wider(rooms, more) for more in (-1, 0, 1)},
    "closed rooms": closets,
    "closed rooms with pillars": partial(closets, pillars=0.01),
    # A corridor with a dead end beside every wall.
    "comb": lambda y, x, size, fit, rng: (y < fit + 3) | (x % (fit + 1) > 0),
    "rings": rings,
    # Corridors at 45 degrees from a hall.
    "diagonals": lambda y, x, size, fit, rng: (
        ((x + y) % (math.ceil(2**0.5 * fit) + 3) < math.ceil(2**0.5 * fit)) | (abs(y - size // 2) < 20)
    ),
    # Corridors between bands of 60 cells, 15 % of them occupied.
    "bands of noise": lambda y, x, size, fit, rng: (
        (y % (fit + 64) < fit + 4) | (x < fit + 4) | (rng.random((size, size)) >= 0.15)
    ),
    **{f"noise, {share:.0%}": partial(noise, share=share) for share in (0.01, 0.1, 0.4)},
    # Square halls that overlap at their corners.
    "checkerboard": lambda y, x, size, fit, rng: (
        (np.maximum(y % 80, x % 80) < 40 + fit) | (np.maximum((y + 40) % 80, (x + 40) % 80) < 40 + fit)
    ),
    "all free": lambda y, x, size, fit, rng: (y >= 0) & (x >= 0),
    "one disc": lambda y, x, size, fit, rng: np.hypot(y - size // 2, x - size // 2) < 20,
    "one wall": lambda y, x, size, fit, rng: (x != size // 2) | (y < size // 4),
}
"""Shapes by name."""


def write_map(name: str, size: int, folder: Path) -> Path:
    """Write a map of `MAPS` with `size` x `size` cells; return the path of its YAML."""
    fit = math.ceil(2.0 * load_robot("turtlebot3_burger").radius / RESOLUTION) + 1
    y, x = np.ogrid[:size, :size]
    free = MAPS[name](y, x, size, fit, np.random.default_rng(0))
    data = np.full((size, size), 100, dtype=np.int8)
    data[1:-1, 1:-1][free[1:-1, 1:-1]] = 0
    return save_map(OccupancyGrid(data, RESOLUTION, (0.0, 0.0)), folder / "map.yaml")


def reset_once(path: str, case: str) -> tuple[float, int, str, float]:
    """Make an environment on a map and reset it.

    Returns:
        Processor time [s], the number of walls, why the map was refused, and the greatest memory of the process [GiB].
    """
    id, arguments = CASES[case]
    began, walls, refused = time.process_time(), 0, ""
    try:
        env = gymnasium.make(f"envs:lidarnaut/{id}-v0", world=path, map_resolution=RESOLUTION, **arguments).unwrapped
        env.reset(seed=0)
        walls = len((env.explore if id == "ExploreFrontiers" else env).world.segments)
    except ValueError as error:
        refused = str(error)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    return time.process_time() - began, walls, refused, memory


def reset_maps(size: int) -> Report:
    """Reset every case on every map, each in a process of its own; kernels are compiled before."""
    rows, failures = [], []
    with tempfile.TemporaryDirectory() as folder:
        small = write_map(list(MAPS)[-1], 100, Path(folder))
        for case in CASES:
            reset_once(str(small), case)
        for name in Progress(MAPS, desc="maps", unit="map"):
            path = str(write_map(name, size, Path(folder)))
            found = {case: call_elsewhere(reset_once, path, case) for case in CASES}
            times = {f"{case} [s]": f"{r[0]:.1f}" + " (refused)" * bool(r[2]) for case, r in found.items()}
            walls, memory = (max(result[k] for result in found.values()) for k in (1, 3))
            rows.append({"map": name, "walls": walls, **times, "memory [GiB]": f"{memory:.1f}"})
            too_much = {case: r for case, r in found.items() if r[0] > MOST_TIME or r[3] > MOST_MEMORY}
            failures += [f"{name}, {case}: {r[0]:.1f} s, {r[3]:.1f} GiB" for case, r in too_much.items()]
    return rows, failures

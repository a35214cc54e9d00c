"""Large maps of shapes that are hard to work on: what the first reset in a new process takes."""

import json
import math
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import gymnasium
import numpy as np

import envs  # noqa: F401  registers the environments
from envs.geometry import OccupancyGrid
from envs.progress import Progress
from envs.robots import load_robot
from envs.worlds import save_map

ROOT = Path(__file__).parents[2]
"""Folder of the checkout."""
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


@dataclass(frozen=True)
class MapReset:
    """The first reset on a map in a new process."""

    name: str
    """Of the map."""
    case: str
    """Of `CASES`."""
    time: float
    """Processor time of `gymnasium.make` and `reset` [s]."""
    memory: float
    """Greatest resident memory of the process [GiB]."""
    walls: int
    """Segments of the world; 0 if it was refused."""
    refused: str
    """The error, if the robot does not fit or the map is no world; otherwise empty."""


# Free cells by row and column, of a square map of `size` cells. `fit` is the width of the narrowest passage that the
# robot fits through [cells].


def maze(y: np.ndarray, x: np.ndarray, size: int, fit: int, rng: np.random.Generator) -> np.ndarray:
    """Every cell of a lattice is joined to the one above it or to the one beside it, at random."""
    period = fit + 2
    upwards = rng.random((size, size)) < 0.5
    upwards[:, 0], upwards[0] = True, False
    joined = upwards[y // period, x // period]
    along_y, along_x = y % period >= 2, x % period >= 2
    return (along_y & along_x) | (along_x & ~along_y & joined) | (along_y & ~along_x & ~joined)


def rooms(y: np.ndarray, x: np.ndarray, size: int, fit: int, rng: np.random.Generator) -> np.ndarray:
    """Rooms of 40 cells with a door in each wall."""
    in_y, in_x = y % 42 >= 2, x % 42 >= 2
    door_y, door_x = abs(y % 42 - 22) < fit / 2, abs(x % 42 - 22) < fit / 2
    return (in_y & in_x) | (in_y & door_y) | (in_x & door_x)


def closets(
    y: np.ndarray, x: np.ndarray, size: int, fit: int, rng: np.random.Generator, pillars: float = 0.0
) -> np.ndarray:
    """Corridors from one hall, along rooms of 60 cells with a door that is too narrow, and pillars of one cell."""
    wide = fit + 2
    v, u = y % (wide + 64), x % 62
    room = (v >= wide + 2) & (v < wide + 62) & (u >= 2) & (rng.random((size, size)) >= pillars)
    door = (v >= wide) & (v < wide + 2) & (u >= 30) & (u < 29 + fit)
    hall = (x < 100) & (abs(y - size // 2) < 50)
    return (v < wide) | (x < wide) | room | door | hall


def comb(y: np.ndarray, x: np.ndarray, size: int, fit: int, rng: np.random.Generator) -> np.ndarray:
    """A corridor with a dead end beside every wall."""
    return (y < fit + 3) | (x % (fit + 1) > 0)


def rings(y: np.ndarray, x: np.ndarray, size: int, fit: int, rng: np.random.Generator) -> np.ndarray:
    """Square corridors around each other, joined to the left and to the right by turns."""
    depth = np.minimum(np.minimum(x, y), np.minimum(size - 1 - x, size - 1 - y))
    ring = depth // (fit + 2)
    gap = (abs(y - size // 2) < fit) & ((x < size // 2) == (ring % 2 == 0))
    return (depth % (fit + 2) >= 2) | gap


def noise(
    y: np.ndarray, x: np.ndarray, size: int, fit: int, rng: np.random.Generator, share: float = 0.1
) -> np.ndarray:
    """Single occupied cells, around a hall in the middle."""
    return (rng.random((size, size)) >= share) | (np.maximum(abs(y - size // 2), abs(x - size // 2)) < 20)


def bands(y: np.ndarray, x: np.ndarray, size: int, fit: int, rng: np.random.Generator) -> np.ndarray:
    """Corridors between bands of 60 cells, 15 % of them occupied."""
    return (y % (fit + 64) < fit + 4) | (x < fit + 4) | (rng.random((size, size)) >= 0.15)


def checkerboard(y: np.ndarray, x: np.ndarray, size: int, fit: int, rng: np.random.Generator) -> np.ndarray:
    """Square halls that overlap at their corners."""
    wide = 40 + fit
    return ((y % 80 < wide) & (x % 80 < wide)) | (((y + 40) % 80 < wide) & ((x + 40) % 80 < wide))


def diagonals(y: np.ndarray, x: np.ndarray, size: int, fit: int, rng: np.random.Generator) -> np.ndarray:
    """Corridors at 45 degrees from a hall."""
    wide = math.ceil(math.sqrt(2.0) * fit)
    return ((x + y) % (wide + 3) < wide) | (abs(y - size // 2) < 20)


MAPS: dict[str, tuple[Callable[..., np.ndarray], int]] = {
    **{f"maze, corridors {more:+d}": (maze, more) for more in (-1, 0, 1)},
    **{f"rooms, doors {more:+d}": (rooms, more) for more in (-1, 0, 1)},
    "closed rooms": (closets, 0),
    "closed rooms with pillars": (partial(closets, pillars=0.01), 0),
    "comb": (comb, 0),
    "rings": (rings, 0),
    "diagonals": (diagonals, 0),
    "bands of noise": (bands, 0),
    **{f"noise, {share:.0%}": (partial(noise, share=share), 0) for share in (0.01, 0.1, 0.4)},
    "checkerboard": (checkerboard, 0),
    "all free": (lambda y, x, size, fit, rng: (y >= 0) & (x >= 0), 0),
    "one disc": (lambda y, x, size, fit, rng: np.hypot(y - size // 2, x - size // 2) < 20, 0),
    "one wall": (lambda y, x, size, fit, rng: (x != size // 2) | (y < size // 4), 0),
}
"""Shape by name, and by how many cells its passages are wider than what the robot fits through."""


def write_map(name: str, size: int, folder: Path) -> Path:
    """Write a map of `MAPS` with `size` x `size` cells; return the path of its YAML."""
    draw, more = MAPS[name]
    fit = math.ceil(2.0 * load_robot("turtlebot3_burger").radius / RESOLUTION) + 1 + more
    y, x = np.ogrid[:size, :size]
    free = draw(y, x, size, fit, np.random.default_rng(0))
    data = np.full((size, size), 100, dtype=np.int8)
    data[1:-1, 1:-1][free[1:-1, 1:-1]] = 0
    return save_map(OccupancyGrid(data, RESOLUTION, (0.0, 0.0)), folder / "map.yaml")


def reset_once(path: str, case: str) -> tuple[float, int, str]:
    """Make an environment on a map and reset it; return processor time [s], the number of walls, and why not."""
    id, arguments = CASES[case]
    began, walls, refused = time.process_time(), 0, ""
    try:
        env = gymnasium.make(f"lidarnaut/{id}-v0", world=path, map_resolution=RESOLUTION, **arguments).unwrapped
        env.reset(seed=0)
        walls = len((env.explore if id == "ExploreFrontiers" else env).world.segments)
    except ValueError as error:
        refused = str(error)
    return time.process_time() - began, walls, refused


def measure(names: list[str], size: int) -> list[MapReset]:
    """Reset every case on every map, each in a process of its own; kernels are compiled before.

    Raises:
        RuntimeError: a process failed.
    """
    results = []
    with tempfile.TemporaryDirectory() as folder:
        small = write_map("rooms, doors +1", 100, Path(folder))
        for case in CASES:
            reset_once(str(small), case)
        for name in Progress(names, desc="maps", unit="map"):
            path = write_map(name, size, Path(folder))
            results += [MapReset(name, case, *_reset_elsewhere(path, case)) for case in CASES]
    return results


def _reset_elsewhere(path: Path, case: str) -> tuple[float, float, int, str]:
    command = [sys.executable, "-m", "benchmarks.robustness.maps", str(path), case]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)} failed: {done.stderr[-2000:]}")
    seconds, memory, walls, refused = json.loads(done.stdout.splitlines()[-1])
    return seconds, memory, walls, refused


if __name__ == "__main__":
    seconds, walls, refused = reset_once(*sys.argv[1:])
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(json.dumps([seconds, memory, walls, refused]))

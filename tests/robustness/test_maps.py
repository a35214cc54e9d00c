"""Difficult map shapes: they are usable or refused by name, and large maps take little time."""

import math
import resource
import time
from functools import partial

import gymnasium
import numpy as np
import pytest

from lidarnaut.envs.geometry import OccupancyGrid
from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.worlds import load_map, save_map
from tests.robustness.conftest import in_new_process

CASES = {
    "Explore-v0, kinematic, truth": ("Explore", {"physics": "kinematic", "slam": "truth"}),
    "Explore-v0": ("Explore", {}),
    "ExploreFrontiers-v0": ("ExploreFrontiers", {}),
    "Navigate-v0": ("Navigate", {}),
}
"""Ids and arguments; bullet and the default SLAM unless given."""
RESOLUTION = 0.05
MOST_TIME, MOST_MEMORY = 10.0, 4.0
"""Limits of a reset: processor time [s], and memory of the process [GiB]."""


# Free cells by row and column, of a square map of `size` cells. `fit` is the width of the narrowest passage that the
# robot fits through [cells].


def maze(y, x, size, fit, rng):
    """Each cell of a lattice is joined to the cell above or next to it, at random."""
    period = fit + 2
    upwards = rng.random((size, size)) < 0.5
    upwards[:, 0], upwards[0] = True, False
    joined = upwards[y // period, x // period]
    along_y, along_x = y % period >= 2, x % period >= 2
    return (along_y & along_x) | (along_x & ~along_y & joined) | (along_y & ~along_x & ~joined)


def rooms(y, x, size, fit, rng):
    """Rooms of 40 cells with a door in each wall."""
    in_y, in_x = y % 42 >= 2, x % 42 >= 2
    door_y, door_x = abs(y % 42 - 22) < fit / 2, abs(x % 42 - 22) < fit / 2
    return (in_y & in_x) | (in_y & door_y) | (in_x & door_x)


def closets(y, x, size, fit, rng, pillars=0.0):
    """Corridors from one hall, along rooms of 60 cells with a door that is too narrow, and pillars of one cell."""
    wide = fit + 2
    v, u = y % (wide + 64), x % 62
    room = (v >= wide + 2) & (v < wide + 62) & (u >= 2) & (rng.random((size, size)) >= pillars)
    door = (v >= wide) & (v < wide + 2) & (u >= 30) & (u < 29 + fit)
    hall = (x < 100) & (abs(y - size // 2) < 50)
    return (v < wide) | (x < wide) | room | door | hall


def rings(y, x, size, fit, rng):
    """Concentric square corridors, joined alternately on the left and on the right."""
    depth = np.minimum(np.minimum(x, y), np.minimum(size - 1 - x, size - 1 - y))
    ring = depth // (fit + 2)
    gap = (abs(y - size // 2) < fit) & ((x < size // 2) == (ring % 2 == 0))
    return (depth % (fit + 2) >= 2) | gap


def noise(y, x, size, fit, rng, share):
    """Single occupied cells, around a hall in the middle."""
    return (rng.random((size, size)) >= share) | (np.maximum(abs(y - size // 2), abs(x - size // 2)) < 20)


def wider(shape, more):
    """Return a shape with passages that are `more` cells wider than the narrowest passable width."""
    return lambda y, x, size, fit, rng: shape(y, x, size, fit + more, rng)


MAPS = {
    **{f"maze, corridors {more:+d}": wider(maze, more) for more in (-1, 0, 1)},
    **{f"rooms, doors {more:+d}": wider(rooms, more) for more in (-1, 0, 1)},
    "closed rooms": closets,
    "closed rooms with pillars": partial(closets, pillars=0.01),
    # A corridor with dead ends next to every wall.
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


def write_map(name, size, folder):
    fit = math.ceil(2.0 * load_robot("turtlebot3_burger").radius / RESOLUTION) + 1
    y, x = np.ogrid[:size, :size]
    free = MAPS[name](y, x, size, fit, np.random.default_rng(0))
    data = np.full((size, size), 100, dtype=np.int8)
    data[1:-1, 1:-1][free[1:-1, 1:-1]] = 0
    return save_map(OccupancyGrid(data, RESOLUTION, (0.0, 0.0)), folder / "map.yaml")


def reset_once(path, case):
    """Reset an environment on a map; return processor time [s], walls, reason of a refusal, memory [GiB]."""
    (id, arguments), began, walls, refused = CASES[case], time.process_time(), 0, ""
    try:
        env = gymnasium.make(f"lidarnaut:lidarnaut/{id}-v0", world=str(path), map_resolution=RESOLUTION, **arguments)
        env.reset(seed=0)
        walls = len(getattr(env.unwrapped, "explore", env.unwrapped).world.segments)
    except ValueError as error:
        refused = str(error)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    return time.process_time() - began, walls, refused, memory


@pytest.mark.parametrize("name", MAPS)
def test_hard_maps_are_driven_on_or_refused_by_name(name, tmp_path):
    path = write_map(name, 240, tmp_path)
    assert 0.005 < np.mean(load_map(path).data == 0) < 0.99
    _, walls, refused, _ = reset_once(path, "Explore-v0, kinematic, truth")
    assert (walls > 0) == (name != "maze, corridors -1")
    assert ("does not fit" in refused) == (name == "maze, corridors -1")


@pytest.mark.slow
@pytest.mark.parametrize("name", MAPS)
def test_large_maps_are_reset_in_little_time_and_memory(name, tmp_path, row):
    small = write_map("one wall", 100, tmp_path)
    for case in CASES:
        reset_once(small, case)
    path = write_map(name, 5000, tmp_path)
    found = {case: in_new_process(reset_once, path, case) for case in CASES}
    times = {f"{case} [s]": f"{r[0]:.1f}" + " (refused)" * bool(r[2]) for case, r in found.items()}
    walls, memory = (max(result[k] for result in found.values()) for k in (1, 3))
    row("maps of 5,000 x 5,000 cells", map=name, walls=walls, **times, **{"memory [GiB]": memory})
    assert memory < MOST_MEMORY
    assert max(result[0] for result in found.values()) < MOST_TIME

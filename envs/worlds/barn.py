import math
from functools import lru_cache
from pathlib import Path

import numpy as np

from lidarnaut.envs.files import open_archive
from lidarnaut.envs.geometry import Pose2D

from .world import World, edges

BARN_NAMES = tuple(f"barn:{number}" for number in range(300))
_OPTIMAL_SPEED = 2.0
"""Robot speed assumed in the optimal times of the BARN benchmark [m/s]."""
_WALL_DISTANCE = 5.0


@lru_cache(maxsize=len(BARN_NAMES))
def barn_world(name: str) -> World:
    """Return a world of the BARN benchmark, a field of cylinders (cached); ValueError for an unknown name."""
    if name not in BARN_NAMES:
        raise ValueError(f"unknown world {name!r}; BARN worlds are {BARN_NAMES[0]} to {BARN_NAMES[-1]}")
    number = BARN_NAMES.index(name)
    with open_archive(Path(__file__).with_suffix(".npz")) as archive:
        # Remove the float32 rounding error of the archive.
        first, last = archive["offsets"][number : number + 2]
        centres, radius = archive["centres"][first:last].astype(np.float64).round(3), round(float(archive["radius"]), 3)
        ends = np.array([archive["start"][:2], archive["goal"]], dtype=np.float64)
        length = float(archive["optimal_time"][number]) * _OPTIMAL_SPEED
    points = np.vstack([centres, ends])
    (x_min, y_min), (x_max, y_max) = points.min(axis=0) - _WALL_DISTANCE, points.max(axis=0) + _WALL_DISTANCE
    start, goal = (Pose2D(x, y, math.pi / 2) for x, y in ends.tolist())
    corners = np.array([[x_min, y_min], [x_max, y_min], [x_max, y_max], [x_min, y_max]])
    return World(
        name=name,
        segments=edges(corners),
        circles=np.column_stack([centres, np.full(len(centres), radius)]),
        spawns=(start,),
        bounds=(float(x_min), float(y_min), float(x_max), float(y_max)),
        goals=(goal,),
        optimal_length=length,
        source="Daffan/the-barn-challenge (2022); D. Perille, A. Truong, X. Xiao and P. Stone, Benchmarking Metric "
        "Ground Navigation, SSRR 2020",
        licence="MIT",
        notes="The source is open beyond the goal: a rectangle 5 m from cylinders, start and goal closes it.",
    )

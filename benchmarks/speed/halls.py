"""Random but reproducible worlds (square halls) with a given number of obstacles."""

import math
from functools import lru_cache

import numpy as np

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.worlds.world import World, box, edges

SIDE = 16.0
"""Inner side length of a hall [m]."""
GAP, FREE_AROUND_SPAWN = 0.35, 0.7
"""Minimum distance between obstacles, and between obstacles and the start pose [m]."""
PACKING = 0.45
"""Share of the floor covered by obstacles if all have maximum size, with half of `GAP` around each; sets this size."""
PILLARS = 10
"""Every tenth obstacle of a hall is a cylinder (pillar); the others are boxes."""


@lru_cache(maxsize=2)
def make_hall(num_bodies: int) -> World:
    """Return a hall with crates and pillars at random but reproducible poses; raise RuntimeError if they do not fit."""
    rng = np.random.default_rng(num_bodies)
    largest = math.sqrt(PACKING * SIDE**2 / (math.pi * num_bodies)) - 0.5 * GAP
    placed = np.empty((0, 3))
    for _ in range(1000 * num_bodies):
        if len(placed) == num_bodies:
            break
        radius = rng.uniform(0.6, 1.0) * largest
        x, y = rng.uniform(-0.5 * SIDE + GAP + radius, 0.5 * SIDE - GAP - radius, 2)
        distances = np.hypot(placed[:, 0] - x, placed[:, 1] - y) - placed[:, 2]
        if (distances >= radius + GAP).all() and math.hypot(x, y) >= radius + FREE_AROUND_SPAWN:
            placed = np.vstack([placed, [x, y, radius]])
    else:
        raise RuntimeError(f"{num_bodies} bodies do not fit into a hall of {SIDE} m x {SIDE} m")
    crates = []
    for x, y, radius in np.delete(placed, np.s_[::PILLARS], axis=0).tolist():
        # Crates are inscribed in their circle at any yaw.
        diagonal = rng.uniform(math.pi / 8, 3 * math.pi / 8)
        size = 2.0 * radius * math.cos(diagonal), 2.0 * radius * math.sin(diagonal)
        crates.append((x, y, *size, float(rng.uniform(-math.pi, math.pi))))
    half = 0.5 * SIDE
    segments = np.vstack([edges(box(*sides)) for sides in ((0.0, 0.0, SIDE, SIDE), *crates)])
    pillars = np.ascontiguousarray(placed[::PILLARS] * (1.0, 1.0, 0.5))
    spawns, bounds = (Pose2D(0.0, 0.0, 0.0),), (-half, -half, half, half)
    return World(f"hall_{num_bodies}", segments, pillars, spawns=spawns, bounds=bounds)

"""Benchmark of compiled (Numba) kernels."""

import math
from collections.abc import Callable
from functools import partial
from timeit import timeit
from typing import Any

import numpy as np
from numba import njit

from lidarnaut.benchmarks.speed.designs import benchmark_robot
from lidarnaut.benchmarks.speed.halls import make_hall
from lidarnaut.envs.estimation.map_pyramid import Level, crop_level, pool_cells
from lidarnaut.envs.estimation.scan_points import project_hits
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.geometry.raycast import cast_rays
from lidarnaut.envs.observations import NEAR_PIXEL
from lidarnaut.envs.simulation.kinematic import advance
from lidarnaut.envs.simulation.records import STATE_SIZE, robot_record
from lidarnaut.envs.slam import load_params
from lidarnaut.envs.slam.grid_map import GridMap, integrate_scan
from lidarnaut.envs.slam.matcher import match, search_params

PERIOD, CROP_SIZE, CALLS = 0.1, 40, 1000
"""Control period [s], side of a map crop [pixels], kernel calls per timing."""


@njit
def _repeat(times, kernel, arguments):
    for _ in range(times):
        kernel(*arguments)


@njit
def _match(words, points, count, start, search, noise, trace, out):
    out[0], out[1], out[2] = match(words, points, count, start, search, noise, trace)[:3]


def time_kernels(num_bodies: int, repeats: int) -> list[dict[str, Any]]:
    """Return the median times of kernels in a hall with `num_bodies` obstacles [us]."""
    rows = []
    for name, (function, *arguments) in make_kernels(num_bodies).items():
        call = partial(_repeat, CALLS, function, tuple(arguments))
        call()
        us = 1e6 * float(np.median([timeit(call, number=1) / CALLS for _ in range(repeats)]))
        rows.append({"kernel": name, "bodies": num_bodies, "us": us})
    return rows


def make_kernels(num_bodies: int) -> dict[str, tuple[Callable[..., Any], *tuple[Any, ...]]]:
    """Return the kernels by name, each followed by its arguments."""
    world, robot, params = make_hall(num_bodies), benchmark_robot(), load_params("default")
    lidar, rng = robot.lidar, np.random.default_rng(0)
    grid_map, empty = GridMap(params, lidar), GridMap(params, lidar)
    ranges, obstacles = np.empty(lidar.num_beams, dtype=np.float32), (world.segments, world.circles)
    for angle in np.arange(12) * math.pi / 6:
        pose = Pose2D(0.2 * math.cos(angle), 0.2 * math.sin(angle), float(angle))
        # Pose of the lidar; the map frame equals the world frame.
        sensor = pose.compose(Pose2D(lidar.mount.x, lidar.mount.y, lidar.mount.yaw))
        cast_rays(*sensor, lidar.beams, *obstacles, ranges)
        noisy = ranges + rng.normal(0.0, lidar.noise_std, ranges.shape).astype(np.float32)
        update = grid_map.integrate(noisy, pose, params.quality)
    start = *grid_map.to_cells(pose.x + 0.01, pose.y), pose.theta + 0.01
    points = np.empty((2, len(noisy)), dtype=np.float32)
    count = project_hits(noisy, grid_map.geometry, points)
    noise, trace = np.random.default_rng(0).standard_normal((params.max_tries, 3)), np.empty((params.max_tries + 1, 5))
    room = np.empty((lidar.num_beams, 3)), *np.empty((2, empty.words.size, 2), dtype=np.int32)
    over = empty.geometry, empty.corner, empty.model, params.quality, *room
    grid = grid_map.grid
    level, crop = Level(round(NEAR_PIXEL / grid.resolution), None), np.empty((3, CROP_SIZE, CROP_SIZE), dtype=np.uint8)
    level.rebuild(grid.data)
    changed: Any = np.concatenate([update.new_cells, update.changed_cells])
    side = level.block * grid.resolution
    where = (pose.x - grid.origin[0]) / side, (pose.y - grid.origin[1]) / side, pose.theta, NEAR_PIXEL / side
    driven = np.zeros(STATE_SIZE), (0.1, 1.0), (0.3, -0.2), robot_record(robot, PERIOD)
    return {
        "cast_rays": (cast_rays, *sensor, lidar.beams, *obstacles, ranges),
        "match": (_match, grid_map.words, points, count, start, search_params(params), noise, trace, np.empty(3)),
        "integrate_scan": (integrate_scan, empty.words, empty.grid.data, noisy, tuple(pose), *over),
        "pool_map": (pool_cells, grid.data, changed, level.block, level.words),
        "crop": (crop_level, level.words, level.height, level.width, *where, crop),
        "advance": (advance, *driven, *obstacles),
    }

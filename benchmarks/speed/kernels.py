"""Benchmark of compiled (Numba) kernels against equivalent NumPy code."""

import math
from collections.abc import Callable
from functools import partial
from timeit import timeit
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from lidarnaut.benchmarks.speed.designs import benchmark_robot
from lidarnaut.benchmarks.speed.halls import make_hall
from lidarnaut.benchmarks.speed.naive_slam import NaiveSlam
from lidarnaut.benchmarks.speed.naive_slam import match as naive_match
from lidarnaut.benchmarks.speed.references import advance_in_numpy, cast_rays_in_numpy, crop_in_numpy, pool_in_numpy
from lidarnaut.envs.estimation.map_pyramid import Level, crop_level, pool_cells
from lidarnaut.envs.estimation.scan_points import project_hits
from lidarnaut.envs.geometry import OccupancyGrid, Pose2D, Window
from lidarnaut.envs.geometry.raycast import cast_rays
from lidarnaut.envs.observations import NEAR_PIXEL
from lidarnaut.envs.robots import LidarParams
from lidarnaut.envs.simulation.kinematic import advance
from lidarnaut.envs.simulation.records import STATE_SIZE, robot_record
from lidarnaut.envs.slam import load_params
from lidarnaut.envs.slam.grid_map import GridMap, integrate_scan, probabilities
from lidarnaut.envs.slam.matcher import match, search_params

PERIOD, CROP_SIZE, CALLS = 0.1, 40, 1000
"""Control period [s], side of a map crop [pixels], kernel calls per timing."""


class Kernel(NamedTuple):
    """Benchmarked kernel: compiled function, its arguments, and a NumPy function with equal results."""

    name: str
    function: Any
    arguments: tuple[Any, ...]
    read: Callable[[], np.ndarray]
    reference: Callable[[], np.ndarray]


@njit
def _repeat(times, kernel, arguments):
    for _ in range(times):
        kernel(*arguments)


@njit
def _match(words, points, count, start, search, noise, trace, out):
    out[0], out[1], out[2] = match(words, points, count, start, search, noise, trace)[:3]


def time_kernels(num_bodies: int, repeats: int) -> list[dict[str, Any]]:
    """Return the median times of kernels and NumPy references in a hall with `num_bodies` obstacles [us]."""
    rows = []
    for name, function, arguments, _, reference in make_kernels(num_bodies):
        _repeat(1, function, arguments)
        fast = partial(_repeat, CALLS, function, arguments)
        times = [[timeit(fast, number=1) / CALLS, timeit(reference, number=10) / 10] for _ in range(repeats)]
        us, slow_us = (1e6 * np.median(times, axis=0)).tolist()
        rows.append({"kernel": name, "bodies": num_bodies, "us": us, "NumPy us": slow_us, "ratio": slow_us / us})
    return rows


def make_kernels(num_bodies: int) -> list[Kernel]:
    world, robot, params = make_hall(num_bodies).world, benchmark_robot(), load_params("default")
    lidar, rng = robot.lidar, np.random.default_rng(0)
    grid_map, naive = GridMap(params, lidar), NaiveSlam(lidar, params)
    ranges, obstacles = np.empty(lidar.num_beams, dtype=np.float32), (world.segments, world.circles)
    for angle in np.arange(12) * math.pi / 6:
        naive.pose = pose = Pose2D(0.2 * math.cos(angle), 0.2 * math.sin(angle), float(angle))
        # Pose of the lidar; the map frame equals the world frame.
        sensor = pose.compose(Pose2D(lidar.mount.x, lidar.mount.y, lidar.mount.yaw))
        cast_rays(*sensor, lidar.beams, *obstacles, ranges)
        noisy = ranges + rng.normal(0.0, lidar.noise_std, ranges.shape).astype(np.float32)
        naive.integrate(noisy, params.quality)
        grid_map.integrate(noisy, pose, params.quality)
    x, y, theta = sensor
    params, start = load_params("default"), Pose2D(*grid_map.to_cells(pose.x + 0.01, pose.y), pose.theta + 0.01)
    points, search, found = np.empty((2, len(noisy)), dtype=np.float32), search_params(params), np.empty(3)
    count = project_hits(noisy, grid_map.geometry, points)
    noise, trace = np.random.default_rng(0).standard_normal((params.max_tries, 3)), np.empty((params.max_tries + 1, 5))
    slow = (naive.values, points[:, :count], start, search[:2], (0.0, 0.0), noise, params.max_failed)
    command, normals, record, driven = (0.1, 1.0), (0.3, -0.2), robot_record(robot, PERIOD), np.zeros(STATE_SIZE)
    moved = (np.zeros(STATE_SIZE), command, normals, PERIOD, int(record.substeps), robot, *obstacles)
    return [
        Kernel(
            "cast_rays", cast_rays, (x, y, theta, lidar.beams, *obstacles, ranges), lambda: ranges,
            lambda: cast_rays_in_numpy(x, y, theta + lidar.angles, lidar.range_max, *obstacles),
        ),
        Kernel(
            "match", _match, (grid_map.words, points, count, tuple(start), search, noise, trace, found), lambda: found,
            lambda: np.array(naive_match(*slow)),
        ),
        _integrate_scan(lidar, noisy, pose),
        *_crop(grid_map.grid, pose),
        Kernel(
            "advance", advance, (driven, command, normals, record, *obstacles), driven.copy,
            partial(advance_in_numpy, *moved),
        ),
    ]  # fmt: skip


def _integrate_scan(lidar: LidarParams, ranges: np.ndarray, pose: Pose2D) -> Kernel:
    params = load_params("default")
    empty, naive = GridMap(params, lidar), NaiveSlam(lidar, params)
    naive.pose = pose
    room = np.empty((lidar.num_beams, 3)), np.empty((empty.words.size, 2), dtype=np.int32)
    over = (empty.geometry, empty.corner, empty.model, params.quality, *room)

    def reference() -> np.ndarray:
        naive.integrate(ranges, params.quality)  # averaging the same scan again changes nothing
        return naive.values

    arguments = (empty.words, empty.grid.data, ranges, tuple(pose), *over)
    return Kernel("integrate_scan", integrate_scan, arguments, lambda: probabilities(empty.words), reference)


def _crop(grid: OccupancyGrid, pose: Pose2D) -> list[Kernel]:
    level, crop = Level(round(NEAR_PIXEL / grid.resolution), None), np.empty((3, CROP_SIZE, CROP_SIZE), dtype=np.uint8)
    level.rebuild(grid.data)
    rows, cols = np.nonzero(grid.data >= 0)
    window = Window.spanning((int(rows.min()), int(cols.min())), (int(rows.max()), int(cols.max())))
    side, visited = level.block * grid.resolution, np.empty((0, 2), dtype=np.int64)
    x, y = (pose.x - grid.origin[0]) / side, (pose.y - grid.origin[1]) / side
    pooled, where = pool_in_numpy(grid.data, visited, level.block), (x, y, pose.theta, NEAR_PIXEL / side)
    return [
        Kernel(
            "pool_map", pool_cells, (grid.data, window, level.block, level.words),
            lambda: level.words[:-1].reshape(level.height, level.width) & 0xFF,
            lambda: pool_in_numpy(grid.data, visited, level.block)[1],
        ),
        Kernel(
            "crop", crop_level, (level.words, level.height, level.width, *where, crop), lambda: crop,
            lambda: crop_in_numpy(pooled, *where, CROP_SIZE),
        ),
    ]  # fmt: skip

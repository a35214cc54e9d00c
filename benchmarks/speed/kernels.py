"""Kernels, one by one, beside the same work in plain NumPy.

They run in compiled loops: from Python each call would cost microseconds of its own. The loops are compiled anew in
each run, since cached ones would not notice that a kernel has changed.
"""

import math
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from benchmarks.speed.designs import benchmark_robot
from benchmarks.speed.halls import make_hall
from benchmarks.speed.naive_slam import NaiveSlam
from benchmarks.speed.naive_slam import match as naive_match
from benchmarks.speed.references import advance_in_numpy, cast_rays_in_numpy, crop_in_numpy, pool_in_numpy
from envs.estimation import Window
from envs.estimation.map_pyramid import Level, crop_level, pool_cells
from envs.geometry import Pose2D
from envs.geometry.raycast import cast_rays
from envs.observations import NEAR_PIXEL
from envs.simulation.kinematic import Obstacles, advance
from envs.simulation.records import robot_record
from envs.simulation.state import STATE_SIZE
from envs.slam import load_params
from envs.slam.cells import probabilities
from envs.slam.grid_map import GridMap
from envs.slam.map_update import integrate_scan
from envs.slam.matcher import match, search_params
from envs.slam.scans import beam_ends, project_hits

PERIOD, CROP_SIZE, REPEATS = 0.1, 40, 5
"""Control period [s]; pixels along the sides of a crop; measurements of which the median is taken."""


class Kernel(NamedTuple):
    """A kernel and the same work in NumPy, on the same input."""

    name: str
    repeat: Callable[[int], object]
    """Runs it so many times, from compiled code as its users do."""
    result: Callable[[], np.ndarray]
    """Runs it once and returns what it computes."""
    reference: Callable[[], np.ndarray]


@njit
def _repeat(times, kernel, arguments):
    for _ in range(times):
        kernel(*arguments)


@njit
def _repeat_varied(times, kernel, before, x, after):
    # An argument differs from call to call, such that no compiler takes the work out of the loop.
    for i in range(times):
        kernel(*(before + (x + 1e-9 * i,) + after))  # Numba joins tuples by +


@njit
def _match_from(words, points, count, x, start, search, noise):
    match(words, points, count, (x, start[1], start[2]), search, noise)


@njit
def _integrate(words, occupancy, scan, y, c, s, ends, model, quality, new_cells, x):
    beam_ends(*scan, x, y, c, s, ends)
    integrate_scan(words, occupancy, ends, x, y, model, quality, new_cells)


def time_kernels(num_bodies: int, seconds: float) -> list[dict[str, Any]]:
    """Return the median times of kernels and their references in a hall, for some seconds each in turn [us]."""
    rows = []
    for kernel in make_kernels(num_bodies):
        ways = (kernel.repeat, lambda count, kernel=kernel: [kernel.reference() for _ in range(count)])
        for repeat in ways:
            repeat(1)
        us, slow = np.median(
            [[_time_call(repeat, seconds) for repeat in ways] for _ in range(REPEATS)], axis=0
        ).tolist()
        rows.append({"kernel": kernel.name, "bodies": num_bodies, "us": us, "NumPy us": slow, "ratio": slow / us})
    return rows


def _time_call(repeat: Callable[[int], object], seconds: float) -> float:
    """Return how long one of many calls takes [us]."""
    count = 1
    while True:
        start = time.perf_counter()
        repeat(count)
        elapsed = time.perf_counter() - start
        if elapsed >= 0.5 * seconds:
            return 1e6 * elapsed / count
        count = max(2 * count, int(count * seconds / max(elapsed, 1e-6)) if elapsed > 1e-4 else 10 * count)


def make_kernels(num_bodies: int) -> list[Kernel]:
    """Prepare every kernel with what it would meet in a hall: a robot with a map of what it has seen so far."""
    world, robot, params = make_hall(num_bodies).world, benchmark_robot(), load_params("default")
    lidar, rng = robot.lidar, np.random.default_rng(0)
    grid_map, naive = GridMap(params, lidar), NaiveSlam(lidar, params)
    ranges, around = np.empty(lidar.num_beams, dtype=np.float32), (world.segments, world.circles)
    for k in range(12):
        angle = 2.0 * math.pi * k / 12
        naive.pose = pose = Pose2D(0.2 * math.cos(angle), 0.2 * math.sin(angle), angle)
        # Pose of the lidar; map frame and world frame are one here.
        sensor = pose.compose(Pose2D(lidar.mount.x, lidar.mount.y, lidar.mount.yaw))
        cast_rays(*sensor, lidar.beams, *around, ranges)
        noisy = ranges + rng.normal(0.0, lidar.noise_std, ranges.shape).astype(np.float32)
        naive.integrate(noisy, params.quality)
        grid_map.integrate(noisy, pose, params.quality)
    return [
        _cast_rays(lidar, sensor, around),
        _match(params, grid_map, naive, noisy, pose),
        _integrate_scan(params, grid_map, lidar, noisy, pose, sensor),
        *_crop(grid_map, pose),
        _advance(robot, *around),
    ]


def _cast_rays(lidar: Any, sensor: Pose2D, around: tuple[np.ndarray, np.ndarray]) -> Kernel:
    out = np.empty(lidar.num_beams, dtype=np.float32)
    rest = (sensor.y, sensor.theta, lidar.beams, *around, out)

    def result() -> np.ndarray:
        cast_rays(sensor.x, *rest)
        return out

    def reference() -> np.ndarray:
        return cast_rays_in_numpy(sensor.x, sensor.y, sensor.theta + lidar.angles, lidar.range_max, *around)

    return Kernel("cast_rays", lambda times: _repeat_varied(times, cast_rays, (), sensor.x, rest), result, reference)


def _match(params: Any, grid_map: GridMap, naive: NaiveSlam, ranges: np.ndarray, pose: Pose2D) -> Kernel:
    points, search = np.empty((2, len(ranges)), dtype=np.float32), search_params(params)
    count = project_hits(ranges, grid_map.geometry, points)
    noise = np.random.default_rng(0).standard_normal((params.max_tries, 3))
    x, y = grid_map.to_cells(pose.x + 0.01, pose.y)
    start, scan = Pose2D(x, y, pose.theta + 0.01), (grid_map.words, points, count)

    def repeat(times: int) -> None:
        _repeat_varied(times, _match_from, scan, start.x, (start, search, noise))

    def reference() -> np.ndarray:
        how = (search[:2], (0.0, 0.0), noise, params.max_failed)
        return np.array(naive_match(naive.values, points[:, :count], start, *how))

    return Kernel("match", repeat, lambda: np.array(match(*scan, tuple(start), search, noise)[:3]), reference)


def _integrate_scan(
    params: Any, grid_map: GridMap, lidar: Any, ranges: np.ndarray, pose: Pose2D, sensor: Pose2D
) -> Kernel:
    (x, y), new_cells = grid_map.to_cells(sensor.x, sensor.y), np.empty((grid_map.words.size, 2), dtype=np.int32)
    scan = (ranges, grid_map.geometry, params.skip_exceeding)
    where = (scan, y, math.cos(pose.theta), math.sin(pose.theta), np.empty((lidar.num_beams, 3)))
    rest = (*where, grid_map.model, params.quality, new_cells)
    naive = NaiveSlam(lidar, params)
    naive.pose = pose

    def repeat(times: int) -> None:
        cells = (grid_map.words.copy(), grid_map.grid.data.copy())
        _repeat_varied(times, _integrate, (*cells, *rest), x, ())

    def result() -> np.ndarray:
        empty = GridMap(params, lidar)
        _integrate(empty.words, empty.grid.data, *rest, x)
        return probabilities(empty.words)

    def reference() -> np.ndarray:
        naive.integrate(ranges, params.quality)  # a mean does not change when the same is averaged in again
        return naive.values

    return Kernel("integrate_scan", repeat, result, reference)


def _crop(grid_map: GridMap, pose: Pose2D) -> list[Kernel]:
    """Return what pools the level of the map that `map_near` crops, and what crops it."""
    grid, crop = grid_map.grid, np.empty((3, CROP_SIZE, CROP_SIZE), dtype=np.uint8)
    level = Level(round(NEAR_PIXEL / grid.resolution), None)
    level.rebuild(grid.data)
    side = level.block * grid.resolution
    (row_min, row_max), (col_min, col_max) = ((axis.min(), axis.max()) for axis in np.nonzero(grid.data >= 0))
    window = Window(*map(int, (col_min, row_min, col_max, row_max)))
    pool = (grid.data, window, level.block, level.words)
    x, y = (pose.x - grid.origin[0]) / side, (pose.y - grid.origin[1]) / side
    rest = (y, pose.theta, NEAR_PIXEL / side)
    blocks = (level.words, level.height, level.width)

    def pooled() -> np.ndarray:
        return pool_in_numpy(grid.data, np.empty((0, 2), dtype=np.int64), level.block)

    def pool_once() -> np.ndarray:
        pool_cells(*pool)
        return level.words[:-1].reshape(level.height, level.width) & 0xFF

    def crop_once() -> np.ndarray:
        crop_level(*blocks, x, *rest, crop)
        return crop

    def repeat(times: int) -> None:
        _repeat_varied(times, crop_level, blocks, x, (*rest, crop))

    slow = pooled()
    return [
        Kernel("pool_map", lambda times: _repeat(times, pool_cells, pool), pool_once, lambda: pooled()[1]),
        Kernel("crop", repeat, crop_once, lambda: crop_in_numpy(slow, x, *rest, CROP_SIZE)),
    ]


def _advance(robot: Any, segments: np.ndarray, circles: np.ndarray) -> Kernel:
    # A circle in the free middle of the hall, driven for ever.
    command, normals, record = (0.1, 1.0), (0.3, -0.2), robot_record(robot, PERIOD)
    driven, at_rest = np.zeros(STATE_SIZE), np.zeros(STATE_SIZE)
    arguments = (driven, command, normals, record, Obstacles(segments, circles, circles))

    def result() -> np.ndarray:
        driven[:] = at_rest
        advance(*arguments)
        return driven

    def reference() -> np.ndarray:
        return advance_in_numpy(at_rest, command, normals, PERIOD, int(record.substeps), robot, segments, circles)

    return Kernel("advance", lambda times: _repeat(times, advance, arguments), result, reference)

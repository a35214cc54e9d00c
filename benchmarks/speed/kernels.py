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

from benchmarks.speed import naive_slam
from benchmarks.speed.designs import benchmark_robot
from benchmarks.speed.halls import Hall
from benchmarks.speed.naive_slam import NaiveSlam
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

PERIOD = 0.1
"""Control period [s]."""
CROP_SIZE = 40
"""Pixels along the sides of a crop."""


class Kernel(NamedTuple):
    """A kernel and the same work in NumPy, on the same input."""

    name: str
    function: Any
    arguments: Callable[[], tuple[Any, ...]]
    varied: int | None
    """The argument that differs from call to call, such that no compiler takes the work out of the loop; None where
    the work changes its own input."""
    result: Callable[[], np.ndarray]
    """Runs it once and returns what it computes."""
    reference: Callable[[], np.ndarray]

    def repeat(self, times: int) -> None:
        """Run it so many times, from compiled code as its users do."""
        arguments, k = self.arguments(), self.varied
        if k is None:
            _repeat(times, self.function, arguments)
        else:
            _repeat_varied(times, self.function, arguments[:k], arguments[k], arguments[k + 1 :])


@njit
def _repeat(times, kernel, arguments):
    for _ in range(times):
        kernel(*arguments)


@njit
def _repeat_varied(times, kernel, before, x, after):
    for i in range(times):
        kernel(*(before + (x + 1e-9 * i,) + after))  # Numba joins tuples by +


@njit
def _match_from(words, points, count, x, start, search, noise):
    match(words, points, count, (x, start[1], start[2]), search, noise)


@njit
def _integrate(cells, scan, x, sensor, ends, how, new_cells):
    words, occupancy = cells
    ranges, geometry, skips_exceeding = scan
    y, c, s = sensor
    beam_ends(ranges, geometry, skips_exceeding, x, y, c, s, ends)
    integrate_scan(words, occupancy, ends, x, y, *how, new_cells)


class Scene:
    """A robot in a hall with a map of what it has seen so far, in the kernels' terms and in those of `NaiveSlam`."""

    def __init__(self, hall: Hall) -> None:
        self.world, self.robot, self.params = hall.world, benchmark_robot(), load_params("default")
        self.lidar = self.robot.lidar
        mount, rng = self.lidar.mount, np.random.default_rng(0)
        ranges = np.empty(self.lidar.num_beams, dtype=np.float32)
        self.map, self.naive = GridMap(self.params, self.lidar), NaiveSlam(self.lidar, self.params)
        for k in range(12):
            angle = 2.0 * math.pi * k / 12
            self.naive.pose = self.pose = Pose2D(0.2 * math.cos(angle), 0.2 * math.sin(angle), angle)
            # Pose of the lidar; map frame and world frame are one here.
            self.sensor = self.pose.compose(Pose2D(mount.x, mount.y, mount.yaw))
            cast_rays(*self.sensor, self.lidar.beams, hall.world.segments, hall.world.circles, ranges)
            self.ranges = ranges + rng.normal(0.0, self.lidar.noise_std, ranges.shape).astype(np.float32)
            self.naive.integrate(self.ranges, self.params.quality)
            self.map.integrate(self.ranges, self.pose, self.params.quality)


def make_kernels(hall: Hall) -> list[Kernel]:
    """Prepare every kernel with what it would meet in a hall."""
    scene = Scene(hall)
    return [make(scene) for make in (_cast_rays, _match, _integrate_scan, _pool_map, _crop, _advance)]


def time_kernel(kernel: Kernel, seconds: float, repeats: int) -> tuple[float, float]:
    """Return the median times of a kernel and of its reference, measured in turn [us]."""
    ways = (kernel.repeat, lambda count: [kernel.reference() for _ in range(count)])
    for repeat in ways:
        repeat(1)
    fast, slow = np.median([[_time_call(repeat, seconds) for repeat in ways] for _ in range(repeats)], axis=0)
    return float(fast), float(slow)


def _time_call(repeat: Callable[[int], Any], seconds: float) -> float:
    """Return how long one of many calls takes [us]."""
    count, elapsed = 1, 0.0
    while True:
        start = time.perf_counter()
        repeat(count)
        elapsed = time.perf_counter() - start
        if elapsed >= 0.5 * seconds:
            return 1e6 * elapsed / count
        count = max(2 * count, int(count * seconds / max(elapsed, 1e-6)) if elapsed > 1e-4 else 10 * count)


def _cast_rays(scene: Scene) -> Kernel:
    lidar, world, sensor = scene.lidar, scene.world, scene.sensor
    out = np.empty(lidar.num_beams, dtype=np.float32)
    around = (world.segments, world.circles)
    arguments = (*sensor, lidar.beams, *around, out)

    def result() -> np.ndarray:
        cast_rays(*arguments)
        return out

    def reference() -> np.ndarray:
        return cast_rays_in_numpy(sensor.x, sensor.y, sensor.theta + lidar.angles, lidar.range_max, *around)

    return Kernel("cast_rays", cast_rays, lambda: arguments, 0, result, reference)


def _match(scene: Scene) -> Kernel:
    params, grid_map, lidar = scene.params, scene.map, scene.lidar
    points = np.empty((2, lidar.num_beams), dtype=np.float32)
    count = project_hits(scene.ranges, grid_map.geometry, points)
    noise = np.random.default_rng(0).standard_normal((params.max_tries, 3))
    search = search_params(params)
    x, y = grid_map.to_cells(scene.pose.x + 0.01, scene.pose.y)
    start = Pose2D(x, y, scene.pose.theta + 0.01)
    arguments = (grid_map.words, points, count, start.x, start, search, noise)

    def reference() -> np.ndarray:
        hits = points[:, :count]
        return np.array(
            naive_slam.match(scene.naive.values, hits, start, search[:2], (0.0, 0.0), noise, params.max_failed)
        )

    def result() -> np.ndarray:
        return np.array(match(grid_map.words, points, count, tuple(start), search, noise)[:3])

    return Kernel("match", _match_from, lambda: arguments, 3, result, reference)


def _integrate_scan(scene: Scene) -> Kernel:
    params, grid_map, lidar = scene.params, scene.map, scene.lidar
    x, y = grid_map.to_cells(scene.sensor.x, scene.sensor.y)
    scan = (scene.ranges, grid_map.geometry, params.skip_exceeding)
    sensor = (y, math.cos(scene.pose.theta), math.sin(scene.pose.theta))
    how = (grid_map.model, params.quality)
    new_cells = np.empty((grid_map.words.size, 2), dtype=np.int32)
    rest = (scan, x, sensor, np.empty((lidar.num_beams, 3)), how, new_cells)
    naive = NaiveSlam(lidar, params)
    naive.pose = scene.pose

    def arguments() -> tuple[Any, ...]:
        return (grid_map.words.copy(), grid_map.grid.data.copy()), *rest

    def result() -> np.ndarray:
        empty = GridMap(params, lidar)
        _integrate((empty.words, empty.grid.data), *rest)
        return probabilities(empty.words)

    def reference() -> np.ndarray:
        naive.integrate(scene.ranges, params.quality)  # a mean does not change when the same is averaged in again
        return naive.values

    return Kernel("integrate_scan", _integrate, arguments, 2, result, reference)


def _pool_map(scene: Scene) -> Kernel:
    grid, level = scene.map.grid, _near_level(scene)
    known = np.argwhere(grid.data >= 0)
    (row_min, col_min), (row_max, col_max) = known.min(axis=0).tolist(), known.max(axis=0).tolist()
    arguments = (grid.data, Window(col_min, row_min, col_max, row_max), level.block, level.words)

    def result() -> np.ndarray:
        pool_cells(*arguments)
        return level.words[:-1].reshape(level.height, level.width) & 0xFF

    def reference() -> np.ndarray:
        return pool_in_numpy(grid.data, np.empty((0, 2), dtype=np.int64), level.block)[1]

    return Kernel("pool_map", pool_cells, lambda: arguments, None, result, reference)


def _crop(scene: Scene) -> Kernel:
    grid, pose, level = scene.map.grid, scene.pose, _near_level(scene)
    crop, side = np.empty((3, CROP_SIZE, CROP_SIZE), dtype=np.uint8), level.block * grid.resolution
    x, y = (pose.x - grid.origin[0]) / side, (pose.y - grid.origin[1]) / side
    pooled = pool_in_numpy(grid.data, np.empty((0, 2), dtype=np.int64), level.block)
    arguments = (level.words, level.height, level.width, x, y, pose.theta, NEAR_PIXEL / side, crop)

    def result() -> np.ndarray:
        crop_level(*arguments)
        return crop

    def reference() -> np.ndarray:
        return crop_in_numpy(pooled, x, y, pose.theta, NEAR_PIXEL / side, CROP_SIZE)

    return Kernel("crop", crop_level, lambda: arguments, 3, result, reference)


def _near_level(scene: Scene) -> Level:
    """Return the level of the map that `map_near` crops."""
    level = Level(round(NEAR_PIXEL / scene.map.grid.resolution), None)
    level.rebuild(scene.map.grid.data)
    return level


def _advance(scene: Scene) -> Kernel:
    world, record = scene.world, robot_record(scene.robot, PERIOD)
    # A circle in the free middle of the hall, driven for ever.
    command, normals = (0.1, 1.0), (0.3, -0.2)
    driven, at_rest = np.zeros(STATE_SIZE), np.zeros(STATE_SIZE)
    obstacles = Obstacles(world.segments, world.circles, world.circles)
    arguments = (driven, command, normals, record, obstacles)

    def result() -> np.ndarray:
        driven[:] = at_rest
        advance(*arguments)
        return driven

    def reference() -> np.ndarray:
        numbers = (PERIOD, int(record.substeps), scene.robot, world.segments, world.circles)
        return advance_in_numpy(at_rest, command, normals, *numbers)

    return Kernel("advance", advance, lambda: arguments, None, result, reference)

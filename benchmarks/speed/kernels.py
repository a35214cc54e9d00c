"""Kernels, one by one, beside the same work in plain NumPy."""

import math
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from benchmarks import naive_slam
from benchmarks.naive_slam import NaiveSlam
from benchmarks.speed.designs import benchmark_robot
from benchmarks.speed.halls import Hall
from benchmarks.speed.loops import (
    repeat_advance,
    repeat_cast_rays,
    repeat_crop,
    repeat_integrate_scan,
    repeat_match,
    repeat_pool_cells,
)
from benchmarks.speed.references import advance_in_numpy, cast_rays_in_numpy, crop_in_numpy, pool_in_numpy
from envs.estimation import Window
from envs.estimation.map_pyramid import Level
from envs.geometry import Pose2D
from envs.geometry.raycast import cast_rays
from envs.observations import NEAR_PIXEL
from envs.robots import robot_record
from envs.simulation.drive import make_timing
from envs.simulation.kinematic import Obstacles
from envs.simulation.state import STATE_SIZE
from envs.slam import load_params
from envs.slam.cells import probabilities
from envs.slam.grid_map import GridMap
from envs.slam.matcher import match, search_params
from envs.slam.scans import project_hits

PERIOD = 0.1
"""Control period [s]."""
CROP_SIZE = 40
"""Pixels along the sides of a crop."""


class Kernel(NamedTuple):
    """A kernel and the same work in NumPy, on the same input."""

    name: str
    """What it is called in tables."""
    repeat: Callable[[int], None]
    """Runs it so many times, from compiled code as its users do."""
    result: Callable[[], np.ndarray]
    """Runs it once and returns what it computes."""
    reference: Callable[[], np.ndarray]
    """Computes the same in NumPy."""


class Scene:
    """A robot in a hall with a map of what it has seen so far, in the kernels' terms and in those of `NaiveSlam`."""

    def __init__(self, hall: Hall) -> None:
        self.world, self.robot, self.params = hall.world, benchmark_robot(), load_params("default")
        self.lidar = self.robot.lidar
        self._rng = np.random.default_rng(0)
        self.map, self.naive = GridMap(self.params, self.lidar), NaiveSlam(self.lidar, self.params)
        for k in range(12):
            angle = 2.0 * math.pi * k / 12
            self.naive.pose = self.pose = Pose2D(0.2 * math.cos(angle), 0.2 * math.sin(angle), angle)
            self.ranges = self._scan()
            self.naive.integrate(self.ranges, self.params.quality)
            self.map.integrate(self.ranges, self.pose, self.params.quality)

    @property
    def sensor(self) -> Pose2D:
        """Pose of the lidar; map frame and world frame are one here."""
        mount = self.lidar.mount
        return self.pose.compose(Pose2D(mount.x, mount.y, mount.yaw))

    def _scan(self) -> np.ndarray:
        ranges = np.empty(self.lidar.num_beams, dtype=np.float32)
        cast_rays(*self.sensor, self.lidar.beams, self.world.segments, self.world.circles, ranges)
        return ranges + self._rng.normal(0.0, self.lidar.noise_std, ranges.shape).astype(np.float32)


def make_kernels(hall: Hall) -> list[Kernel]:
    """Prepare every kernel with what it would meet in a hall."""
    scene = Scene(hall)
    makers = (_cast_rays, _match, _integrate_scan, _pool_map, _crop, _advance)
    return [make(scene) for make in makers]


def time_kernel(kernel: Kernel, seconds: float, repeats: int) -> tuple[float, float]:
    """Return the median times of a kernel and of its reference, measured in turn [us]."""
    kernel.repeat(1)
    kernel.reference()
    fast, slow = [], []
    for _ in range(repeats):
        fast.append(_time_call(kernel.repeat, seconds))
        slow.append(_time_call(lambda count: [kernel.reference() for _ in range(count)], seconds))
    return float(np.median(fast)), float(np.median(slow))


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

    return Kernel(
        "cast_rays",
        lambda times: repeat_cast_rays(times, *arguments),
        result,
        lambda: cast_rays_in_numpy(sensor.x, sensor.y, sensor.theta + lidar.angles, lidar.range_max, *around),
    )


def _match(scene: Scene) -> Kernel:
    params, grid_map, lidar = scene.params, scene.map, scene.lidar
    points = np.empty((2, lidar.num_beams), dtype=np.float32)
    count = project_hits(scene.ranges, grid_map.geometry, points)
    noise = np.random.default_rng(0).standard_normal((params.max_tries, 3))
    search = search_params(params)
    x, y = grid_map.to_cells(scene.pose.x + 0.01, scene.pose.y)
    start = Pose2D(x, y, scene.pose.theta + 0.01)
    hits = (grid_map.words, points, count)
    return Kernel(
        "match",
        lambda times: repeat_match(times, *hits, *start, search, noise),
        lambda: np.array(match(*hits, tuple(start), search, noise)[:3]),
        lambda: np.array(
            naive_slam.match(scene.naive.values, points[:, :count], start, search[:2], noise, params.max_failed)
        ),
    )


def _integrate_scan(scene: Scene) -> Kernel:
    params, grid_map, lidar = scene.params, scene.map, scene.lidar
    x, y = grid_map.to_cells(scene.sensor.x, scene.sensor.y)
    scan = (scene.ranges, grid_map.geometry, params.skip_exceeding)
    sensor = (x, y, math.cos(scene.pose.theta), math.sin(scene.pose.theta))
    ends = np.empty((lidar.num_beams, 3))
    how = (grid_map.model, params.quality)
    new_cells = np.empty((grid_map.words.size, 2), dtype=np.int32)
    naive = NaiveSlam(lidar, params)
    naive.pose = scene.pose

    def repeat(times: int) -> None:
        words, occupancy = grid_map.words.copy(), grid_map.grid.data.copy()
        repeat_integrate_scan(times, words, occupancy, scan, *sensor, ends, *how, new_cells)

    def result() -> np.ndarray:
        empty = GridMap(params, lidar)
        repeat_integrate_scan(1, empty.words, empty.grid.data, scan, *sensor, ends, *how, new_cells)
        return probabilities(empty.words)

    def reference() -> np.ndarray:
        naive.integrate(scene.ranges, params.quality)  # a mean does not change when the same is averaged in again
        return naive.values

    return Kernel("integrate_scan", repeat, result, reference)


def _pool_map(scene: Scene) -> Kernel:
    grid, level = scene.map.grid, _near_level(scene)
    (row_min, col_min), (row_max, col_max) = _known_corners(grid.data)
    window = Window(col_min, row_min, col_max, row_max)

    def result() -> np.ndarray:
        repeat_pool_cells(1, grid.data, window, level.block, level.words)
        return level.words[:-1].reshape(level.height, level.width) & 0xFF

    return Kernel(
        "pool_map",
        lambda times: repeat_pool_cells(times, grid.data, window, level.block, level.words),
        result,
        lambda: pool_in_numpy(grid.data, np.empty((0, 2), dtype=np.int64), level.block)[1],
    )


def _crop(scene: Scene) -> Kernel:
    grid, pose, level = scene.map.grid, scene.pose, _near_level(scene)
    crop, side = np.empty((3, CROP_SIZE, CROP_SIZE), dtype=np.uint8), level.block * grid.resolution
    x, y = (pose.x - grid.origin[0]) / side, (pose.y - grid.origin[1]) / side
    pooled = pool_in_numpy(grid.data, np.empty((0, 2), dtype=np.int64), level.block)

    def repeat(times: int) -> None:
        repeat_crop(times, level.words, level.height, level.width, x, y, pose.theta, NEAR_PIXEL / side, crop)

    def result() -> np.ndarray:
        repeat(1)
        return crop

    return Kernel("crop", repeat, result, lambda: crop_in_numpy(pooled, x, y, pose.theta, NEAR_PIXEL / side, CROP_SIZE))


def _near_level(scene: Scene) -> Level:
    """Return the level of the map that `map_near` crops."""
    level = Level(round(NEAR_PIXEL / scene.map.grid.resolution), None)
    level.rebuild(scene.map.grid.data)
    return level


def _known_corners(data: np.ndarray) -> tuple[list[int], list[int]]:
    """Return first and last (row, column) of what is known of a map, shape (height, width), int8."""
    cells = np.argwhere(data >= 0)
    return cells.min(axis=0).tolist(), cells.max(axis=0).tolist()


def _advance(scene: Scene) -> Kernel:
    world, drive = scene.world, robot_record(scene.robot).drive
    timing = make_timing(drive, PERIOD)
    # A circle in the free middle of the hall, driven for ever.
    command, normals = (0.1, 1.0), (0.3, -0.2)
    driven, at_rest = np.zeros(STATE_SIZE), np.zeros(STATE_SIZE)

    def repeat(times: int) -> None:
        obstacles = Obstacles(world.segments, world.circles, world.circles)
        repeat_advance(times, driven, command, normals, timing, drive, obstacles)

    def result() -> np.ndarray:
        driven[:] = at_rest
        repeat(1)
        return driven

    return Kernel(
        "advance",
        repeat,
        result,
        lambda: advance_in_numpy(at_rest, command, normals, *timing, scene.robot, world.segments, world.circles),
    )

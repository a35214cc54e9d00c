"""Kernels, one by one, beside the same work in plain NumPy."""

import math
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from benchmarks import naive, naive_slam
from benchmarks.naive_slam import NaiveSlam
from benchmarks.speed.designs import benchmark_robot
from benchmarks.speed.halls import Hall
from benchmarks.speed.loops import (
    repeat_advance,
    repeat_cast_rays,
    repeat_count_new,
    repeat_crop,
    repeat_draw_scan,
    repeat_match,
    repeat_pool_map,
)
from benchmarks.speed.references import advance_in_numpy, cast_rays_in_numpy, crop_in_numpy, pool_in_numpy
from envs.coverage import explorable_area
from envs.geometry import Pose2D
from envs.geometry.raycast import cast_rays
from envs.map_pyramid import CROP_SIZE, FAR_PIXEL, NEAR_PIXEL, MapPyramid
from envs.robots import robot_record
from envs.simulation.drive import make_timing
from envs.simulation.kinematic import Obstacles
from envs.simulation.state import STATE_SIZE
from envs.slam import load_params
from envs.slam.cells import probabilities
from envs.slam.grid_map import GridMap
from envs.slam.map_update import AVG
from envs.slam.matcher import match, project_hits

PERIOD = 0.1
"""Control period [s]."""
NUM_NEW_CELLS = 1000
"""Cells that `count_new` is given."""


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
        self.area = explorable_area(self.world, self.robot, self.params.resolution)
        self._rng = np.random.default_rng(0)
        self.map, self.naive = GridMap(self.params, self.lidar), NaiveSlam(self.lidar, self.params)
        for k in range(12):
            angle = 2.0 * math.pi * k / 12
            self.naive.pose = self.pose = Pose2D(0.2 * math.cos(angle), 0.2 * math.sin(angle), angle)
            self.ranges = self._scan()
            self.naive.draw(self.ranges, self.params.quality)
            self.map.draw(self.ranges, self.pose, self.params.quality)
        self.new_cells = np.argwhere(self.naive.counts > 0)[:NUM_NEW_CELLS].astype(np.int32)

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
    makers = (_cast_rays, _match, _draw_scan, _pool_map, _crop, _count_new, _advance)
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
    mount = (lidar.mount.x, lidar.mount.y)
    count = project_hits(scene.ranges, lidar.range_max, grid_map.directions, *mount, params.resolution, points)
    noise = np.random.default_rng(0).standard_normal((params.max_tries, 3))
    sigma = (params.sigma_xy / params.resolution, params.sigma_theta)
    x, y = grid_map.to_cells(scene.pose.x + 0.01, scene.pose.y)
    start = Pose2D(x, y, scene.pose.theta + 0.01)
    search = (*sigma, params.max_failed, params.max_tries, noise, np.empty((0, 5)))
    arguments = (grid_map.words, points, count, grid_map.unvisited, *start)
    return Kernel(
        "match",
        lambda times: repeat_match(times, *arguments, search),
        lambda: np.array(match(*arguments, *search)[:3]),
        lambda: np.array(
            naive_slam.match(scene.naive.values, points[:, :count], start, sigma, noise, params.max_failed)
        ),
    )


def _draw_scan(scene: Scene) -> Kernel:
    params, grid_map, lidar = scene.params, scene.map, scene.lidar
    x, y = grid_map.to_cells(scene.sensor.x, scene.sensor.y)
    scan = (scene.ranges, grid_map.directions, lidar.range_max, params.skip_exceeding)
    place = (x, y, math.cos(scene.pose.theta), math.sin(scene.pose.theta), params.resolution)
    ends = np.empty((lidar.num_beams, 2))
    probs = (params.occupied_prob, params.empty_prob, params.quality)
    how = (AVG, params.estimator == "area", *probs, params.hole_width / params.resolution, params.blur == "add")
    new_cells = np.empty((grid_map.words.size, 2), dtype=np.int32)
    drawn = NaiveSlam(lidar, params)
    drawn.pose = scene.pose

    def repeat(times: int) -> None:
        words, occupancy = grid_map.words.copy(), grid_map.grid.data.copy()
        repeat_draw_scan(times, words, occupancy, scan, *place, ends, how, new_cells)

    def result() -> np.ndarray:
        empty = GridMap(params, lidar)
        repeat_draw_scan(1, empty.words, empty.grid.data, scan, *place, ends, how, new_cells)
        return probabilities(empty.words)

    def reference() -> np.ndarray:
        drawn.draw(scene.ranges, params.quality)  # a mean does not change when the same is averaged in again
        return drawn.values

    return Kernel("draw_scan", repeat, result, reference)


def _pool_map(scene: Scene) -> Kernel:
    grid, pyramid = scene.map.grid, MapPyramid(scene.map.grid)
    cells = np.argwhere(grid.data >= 0)
    (row_min, col_min), (row_max, col_max) = cells.min(axis=0).tolist(), cells.max(axis=0).tolist()
    arguments = (grid.data, (col_min, row_min, col_max, row_max), pyramid.block, pyramid.near, pyramid.far)

    def result() -> np.ndarray:
        repeat_pool_map(1, *arguments)
        return pyramid.near[:-1].reshape(-(-len(grid.data) // pyramid.block), -1) & 0xFF

    return Kernel(
        "pool_map",
        lambda times: repeat_pool_map(times, *arguments),
        result,
        lambda: pool_in_numpy(grid.data, np.empty((0, 2), dtype=np.int64), pyramid.block)[1],
    )


def _crop(scene: Scene) -> Kernel:
    grid, pose, pyramid = scene.map.grid, scene.pose, MapPyramid(scene.map.grid)
    crops = np.empty((2, 3, CROP_SIZE, CROP_SIZE), dtype=np.uint8)
    x, y = pose.x - grid.origin[0], pose.y - grid.origin[1]
    frame = (*grid.data.shape, pyramid.block, grid.resolution, x, y, pose.theta)
    side = pyramid.block * grid.resolution
    nowhere = np.empty((0, 2), dtype=np.int64)
    near = pool_in_numpy(grid.data, nowhere, pyramid.block)
    far = pool_in_numpy(grid.data, nowhere, round(FAR_PIXEL / NEAR_PIXEL) * pyramid.block)

    def repeat(times: int) -> None:
        repeat_crop(times, pyramid.near, pyramid.far, *frame, crops[0], crops[1])

    def result() -> np.ndarray:
        repeat(1)
        return crops

    def reference() -> np.ndarray:
        levels = ((near, side, NEAR_PIXEL), (far, FAR_PIXEL / NEAR_PIXEL * side, FAR_PIXEL))
        views = [
            crop_in_numpy(pooled, x / block, y / block, pose.theta, pixel / block, CROP_SIZE)
            for pooled, block, pixel in levels
        ]
        return np.stack(views)

    return Kernel("crop", repeat, result, reference)


def _count_new(scene: Scene) -> Kernel:
    area, grid, start = scene.area, scene.map.grid, scene.world.spawns[0]
    seen, seen_slowly = np.zeros_like(area.explorable), np.zeros_like(area.explorable)
    map_frame = (*map(float, grid.origin), grid.resolution)
    world_frame = (*map(float, area.walls.origin), area.walls.resolution)

    def repeat(times: int) -> None:
        repeat_count_new(times, scene.new_cells, map_frame, *start, area.explorable, world_frame, seen)

    def result() -> np.ndarray:
        repeat(1)
        return seen

    def reference() -> np.ndarray:
        seen_slowly[:] = False
        naive.count_new(scene.new_cells, grid, start, area, seen_slowly)
        return seen_slowly

    return Kernel("count_new", repeat, result, reference)


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

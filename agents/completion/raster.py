"""Maps on the raster of the completion network: cells of 0.2 m, turned to the direction of the walls."""

import math
from typing import NamedTuple

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry import OCCUPIED_FROM, OccupancyGrid
from lidarnaut.envs.geometry.occupancy_grid import known_window
from lidarnaut.envs.tasks.coverage import Coverage

CELL = 0.2
"""Side of a cell [m]."""
STRIDE = 16
"""Cells per cell of the network's coarsest layer. Corners of rasters are multiples of it, and so do not shift a cell's
place in the network when the map grows."""
MARGIN = STRIDE * CELL
"""Least width of the unknown border around the known cells [m]."""
FREE, OCCUPIED = 1, 2
"""Bits of a cell: it holds free, or occupied, cells of the map; 0 is unknown."""
BIN, NUM_BINS = 0.1, 2048
"""Width [m] and number of the histogram bins of occupied cells along an axis; longer axes wrap around."""
MAX_POINTS = 4000
"""Maximum number of occupied cells that decide about the direction of the walls."""
COARSE, FINE = math.radians(2.0), math.radians(0.5)
"""Steps of the search for the direction of the walls [rad]."""
KEPT_BY = 1.1
"""The direction changes when another one is better by this factor: predictions at equal angles are comparable."""
SAMPLES, TRUE_SAMPLES = 4, 3
"""Numbers of points along the side of a cell that sample the map, and the true floor."""


class TurnedRaster(NamedTuple):
    """Known cells of a map, on a turned raster."""

    codes: np.ndarray
    """Bits `FREE` and `OCCUPIED` of each cell, shape (height, width), uint8."""
    angle: float
    """Direction of the raster's rows, map frame [rad]."""
    corner: tuple[float, float]
    """Corner of cell (0, 0), in the map frame turned by `angle` [m]."""


@njit(cache=True, error_model="numpy")
def _sharpness(points, angle):
    cosine, sine = math.cos(angle), math.sin(angle)
    along, across = np.zeros(NUM_BINS), np.zeros(NUM_BINS)
    for k in range(len(points)):
        x, y = points[k]
        along[math.floor((cosine * x + sine * y) / BIN) % NUM_BINS] += 1.0
        across[math.floor((cosine * y - sine * x) / BIN) % NUM_BINS] += 1.0
    return (along * along).sum() + (across * across).sum()


@njit(cache=True, error_model="numpy")
def _sharpest(points, last):
    best, angle = -1.0, last
    if not math.isnan(last):
        best = KEPT_BY * _sharpness(points, last)
    for k in range(round(0.5 * math.pi / COARSE)):
        sharpness = _sharpness(points, k * COARSE)
        if sharpness > best:
            best, angle = sharpness, k * COARSE
    if angle == last:
        return angle
    coarse = angle
    for k in range(-3, 4):
        sharpness = _sharpness(points, coarse + k * FINE)
        if sharpness > best:
            best, angle = sharpness, coarse + k * FINE
    return angle


def wall_direction(grid: OccupancyGrid, last: float = math.nan) -> float:
    """Return the direction of most walls of a map, modulo a quarter turn [rad].

    At this angle, the histograms of occupied cells along both axes are sharpest: their sums of squares are largest.
    `last`: direction of an earlier map, which is kept unless another one is clearly better.
    """
    window = known_window(grid.data)
    cells = np.argwhere(grid.data[window.slices] >= OCCUPIED_FROM) + (window.row, window.col)
    if len(cells) == 0:
        return 0.0 if math.isnan(last) else last
    return float(_sharpest(grid.centers(cells[:: len(cells) // MAX_POINTS + 1]), last))


@njit(cache=True, error_model="numpy")
def _sample(data, origin, resolution, angle, corner, codes):
    cosine, sine, step = math.cos(angle), math.sin(angle), CELL / SAMPLES
    for row in range(codes.shape[0]):
        for col in range(codes.shape[1]):
            for k in range(SAMPLES * SAMPLES):
                u = corner[0] + col * CELL + (k % SAMPLES + 0.5) * step
                v = corner[1] + row * CELL + (k // SAMPLES + 0.5) * step
                i = math.floor((sine * u + cosine * v - origin[1]) / resolution)
                j = math.floor((cosine * u - sine * v - origin[0]) / resolution)
                if 0 <= i < data.shape[0] and 0 <= j < data.shape[1] and data[i, j] >= 0:
                    codes[row, col] |= OCCUPIED if data[i, j] >= OCCUPIED_FROM else FREE


def turned_raster(grid: OccupancyGrid, angle: float) -> TurnedRaster:
    """Sample the known part of a map and an unknown border, on a raster turned by `angle` [rad]."""
    known = known_window(grid.data)
    rows, cols = np.array([known.row, known.row + known.height]), np.array([known.col, known.col + known.width])
    ys, xs = grid.origin[1] + rows * grid.resolution, grid.origin[0] + cols * grid.resolution
    x, y = np.array([(x, y) for x in xs for y in ys]).T
    turned = np.array([math.cos(angle) * x + math.sin(angle) * y, math.cos(angle) * y - math.sin(angle) * x])
    low = np.floor((turned.min(axis=1) - MARGIN) / MARGIN).astype(int)
    high = np.ceil((turned.max(axis=1) + MARGIN) / MARGIN).astype(int)
    width, height = (STRIDE * (high - low)).tolist()
    codes, (left, bottom) = np.zeros((height, width), dtype=np.uint8), (MARGIN * low).tolist()
    _sample(grid.data, grid.origin, grid.resolution, angle, (left, bottom), codes)
    return TurnedRaster(codes, angle, (left, bottom))


@njit(cache=True, error_model="numpy")
def _sample_floor(explorable, origin, resolution, start, angle, corner, floor):
    cosine, sine, step = math.cos(angle + start[2]), math.sin(angle + start[2]), CELL / TRUE_SAMPLES
    for row in range(floor.shape[0]):
        for col in range(floor.shape[1]):
            count = 0
            for k in range(TRUE_SAMPLES * TRUE_SAMPLES):
                u = corner[0] + col * CELL + (k % TRUE_SAMPLES + 0.5) * step
                v = corner[1] + row * CELL + (k // TRUE_SAMPLES + 0.5) * step
                i = math.floor((start[1] + sine * u + cosine * v - origin[1]) / resolution)
                j = math.floor((start[0] + cosine * u - sine * v - origin[0]) / resolution)
                if 0 <= i < explorable.shape[0] and 0 <= j < explorable.shape[1]:
                    count += explorable[i, j]
            floor[row, col] = 2 * count > TRUE_SAMPLES * TRUE_SAMPLES


def true_floor(coverage: Coverage, raster: TurnedRaster) -> np.ndarray:
    """Return which cells of a raster belong to the floor that the robot can explore, shape (height, width), bool.

    Ground truth, for training: a cell counts by the majority of its points.
    """
    floor, walls = np.zeros(raster.codes.shape, dtype=np.bool_), coverage.area.walls
    frame = walls.origin, walls.resolution, tuple(coverage.start)
    _sample_floor(coverage.area.explorable, *frame, raster.angle, raster.corner, floor)
    return floor

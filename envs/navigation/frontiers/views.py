"""Visibility from viewpoints by ray casting on an occupancy raster.

Rays pass unknown cells and end at occupied cells (González-Baños and Latombe, "Navigation strategies for exploring
indoor environments", 2002).
"""

import math

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry import OCCUPIED, OCCUPIED_FROM, OccupancyGrid
from lidarnaut.envs.geometry.occupancy_grid import crop_to_known
from lidarnaut.envs.navigation.frontiers.frontiers import is_visible

NUM_RAYS = 48
NUM_SECTORS = 24
PER_SECTOR = NUM_RAYS // NUM_SECTORS
RAYS = np.array(
    [(math.sin(angle), math.cos(angle)) for angle in (2.0 * math.pi * k / NUM_RAYS for k in range(NUM_RAYS))]
)
"""Unit ray directions (row, column), shape (NUM_RAYS, 2)."""
SHARE_RADII = (1.0, 2.0, 4.0)
"""Radii of the discs around a frontier whose unknown fractions are policy inputs [m]."""
SHARE_STEPS = 10


@njit(cache=True, error_model="numpy")
def cast_view(occupancy, row, col, reach, free, unknown):
    """Cast rays of length `reach` [cells] from a cell's centre. Cells outside the raster are unknown.

    Writes for each ray: `free`, length up to an occupied cell [cells], and `unknown`, unknown area in view [cells2].
    Returns the index of the ray in the mean direction of the unknown area.
    """
    height, width = occupancy.shape
    per_cell = 2.0 * math.pi / NUM_RAYS
    up, right = 0.0, 0.0
    for k in range(NUM_RAYS):
        d_row, d_col = RAYS[k]
        y, x, area, length = row + 0.5, col + 0.5, 0.0, reach
        for step in range(1, reach + 1):
            y += d_row
            x += d_col
            r, c = math.floor(y), math.floor(x)
            if r < 0 or r >= height or c < 0 or c >= width:
                area += 0.5 * (reach * (reach + 1) - step * (step - 1))
                break
            value = occupancy[r, c]
            if value >= OCCUPIED_FROM:
                length = step - 1
                break
            if value < 0:
                area += step
        free[k], unknown[k] = length, area * per_cell
        up += d_row * area
        right += d_col * area
    return round((math.atan2(up, right) % (2.0 * math.pi)) / per_cell) % NUM_RAYS


def visible_gain(grid: OccupancyGrid, points: np.ndarray, radius: float) -> np.ndarray:
    """Return the unknown area in view within `radius` [m] of each point, shape (n,), float64 [m2].

    `points`: shape (n, 2), map frame [m]. Cells outside the bounds of the observed area do not count.
    """
    known, free, unknown = crop_to_known(grid, margin=0), np.empty(NUM_RAYS), np.empty(NUM_RAYS)
    occupancy = np.pad(known.data, 1, constant_values=OCCUPIED)
    cells, gains = np.clip(known.cells(points), 0, np.array(known.data.shape) - 1), np.zeros(len(points))
    for k, (row, col) in enumerate(cells.tolist()):
        cast_view(occupancy, row + 1, col + 1, round(radius / grid.resolution), free, unknown)
        gains[k] = unknown.sum() * grid.resolution**2
    return gains


@njit(cache=True, error_model="numpy")
def fill_sectors(free, unknown, first, reach, sectors):
    """Summarize the rays of `cast_view` in sectors, counter-clockwise from the ray with index `first`.

    Writes `sectors`, shape (2 * NUM_SECTORS,), float32: length of each sector's shortest ray divided by `reach`, then
    unknown fraction of each sector.
    """
    full = math.pi * reach * (reach + 1) / NUM_RAYS
    for k in range(NUM_SECTORS):
        nearest, area = float(reach), 0.0
        for j in range(PER_SECTOR):
            ray = (first + PER_SECTOR * k + j) % NUM_RAYS
            nearest = min(nearest, free[ray])
            area += unknown[ray]
        sectors[k], sectors[NUM_SECTORS + k] = nearest / reach, area / (PER_SECTOR * full)


@njit(cache=True, error_model="numpy")
def unknown_share(occupancy, row, col, radius):
    """Return the unknown fraction of a disc of `radius` [cells] around a cell, estimated by samples."""
    height, width = occupancy.shape
    step = max(radius / SHARE_STEPS, 1.0)
    num = int(radius / step)
    unknown = count = 0
    for i in range(-num, num + 1):
        for j in range(-num, num + 1):
            if i * i + j * j > num * num:
                continue
            r, c = round(row + i * step), round(col + j * step)
            count += 1
            unknown += r < 0 or r >= height or c < 0 or c >= width or occupancy[r, c] < 0
    return unknown / count


@njit(cache=True, error_model="numpy")
def cheapest_view(data, travel, cells, reach):
    """Find the cell with the lowest path cost that sees any of `cells` from within `reach` cells.

    `travel`: path costs, with a border of one cell. Returns row, column and index of the seen cell in `cells`; -1 for
    none.
    """
    height, width = data.shape
    best, best_row, best_col, seen = travel[0, 0], -1, -1, -1
    for k in range(cells.shape[0]):
        row, col = cells[k]
        for r in range(max(row - reach, 0), min(row + reach + 1, height)):
            for c in range(max(col - reach, 0), min(col + reach + 1, width)):
                if travel[r + 1, c + 1] >= best or (r - row) ** 2 + (c - col) ** 2 > reach * reach:
                    continue
                if is_visible(data, r, c, row, col):
                    best, best_row, best_col, seen = travel[r + 1, c + 1], r, c, k
    return best_row, best_col, seen

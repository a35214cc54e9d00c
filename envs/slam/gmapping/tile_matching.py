"""Gauss-Newton matching of a scan to a map of tiles: as `matching.gauss_newton`, whose cells lie in one array."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from envs.geometry.lookup import load

from ..matching.gauss_newton import COARSE_STEP, MAX_TURN, SMALL_STEP, Fit, solve
from .tiles import EMPTY, TILE, TILE_BITS, level_start


class TileMap(NamedTuple):
    """The map of a particle, to be read."""

    occupancy: np.ndarray
    """Shape (capacity * cells,), int8: the flattened occupancies of the pool."""
    cells: int
    """Cells in a tile, of all levels."""
    slots: np.ndarray
    """Shape (num_tiles,), int32: where the tiles of the map lie in the pool."""
    tiles_wide: int
    """Number of tiles in a row."""
    num_levels: int


class Judgement(NamedTuple):
    """What the finest map says of a scan at a pose."""

    num_known: int
    """Hits that fall in known cells."""
    known_score: float
    """Mean occupancy of those cells, from 0 to 1; 0 without any."""
    squares: float
    """Sum over all hits of (1 - M)^2, see `matching.gauss_newton`."""


@njit(cache=True, error_model="numpy")
def _cell_at(map, level, row, col):
    """Return where a cell of a level lies in the flattened occupancies."""
    bits = TILE_BITS - level
    mask = (1 << bits) - 1
    slot = map.slots[(row >> bits) * map.tiles_wide + (col >> bits)]
    return np.uint64(slot * map.cells + level_start(level) + ((row & mask) << bits) + (col & mask))


@njit(cache=True, error_model="numpy")
def _occupancy(map, at):
    """Return the occupancy in percent, one half for an unknown cell."""
    value = int(load(map.occupancy, at))
    return value if value >= 0 else 50


@njit(cache=True, error_model="numpy")
def _interpolate(map, level, u, v):
    """Return the occupancy in percent at a point, from the centre of the map's first cell [cells of the level].

    Returns:
        The occupancy M, its derivatives along x and y, and whether the point lies inside of the map; outside, one half.
    """
    width, height = _size(map, level)
    if not (u >= 0.0 and v >= 0.0 and u < width - 1 and v < height - 1):
        return 50.0, 0.0, 0.0, False
    col, row = int(u), int(v)
    u, v = u - col, v - row
    bits = TILE_BITS - level
    mask = (1 << bits) - 1
    corner = _cell_at(map, level, row, col)
    if row & mask != mask and col & mask != mask:
        right, above = corner + np.uint64(1), corner + np.uint64(1 << bits)
        opposite = above + np.uint64(1)
    else:
        right, above = _cell_at(map, level, row, col + 1), _cell_at(map, level, row + 1, col)
        opposite = _cell_at(map, level, row + 1, col + 1)
    m_00, m_10 = _occupancy(map, corner), _occupancy(map, above)
    d_0, d_1 = float(_occupancy(map, right) - m_00), float(_occupancy(map, opposite) - m_10)
    low, high = m_00 + u * d_0, m_10 + u * d_1
    return low + v * (high - low), d_0 + v * (d_1 - d_0), high - low, True


@njit(cache=True, error_model="numpy")
def _size(map, level):
    """Return the number of columns and of rows of a level."""
    tiles_high = map.slots.shape[0] // map.tiles_wide
    return map.tiles_wide << (TILE_BITS - level), tiles_high << (TILE_BITS - level)


@njit(cache=True, error_model="numpy")
def evaluate_tiles(map, level, points, num_points, x, y, theta):
    """Return the `Fit` of a scan at a pose on one level; see `evaluate`.

    Args:
        map: `TileMap`.
        level: number of the level.
        points: shape (2, >= num_points), float32, hits in the base frame [cells of the finest level].
        num_points: number of hits.
        x: position from the map's corner [cells of the finest level].
        y: position from the map's corner [cells of the finest level].
        theta: heading [rad].
    """
    scale, c, s = 0.5**level, math.cos(theta), math.sin(theta)
    h_xx = h_xy = h_xt = h_yy = h_yt = h_tt = b_x = b_y = b_t = total = 0.0
    for k in range(num_points):
        p_x, p_y = float(points[0, k]), float(points[1, k])
        r_x, r_y = c * p_x - s * p_y, s * p_x + c * p_y
        m, g_x, g_y, is_inside = _interpolate(map, level, (r_x + x) * scale - 0.5, (r_y + y) * scale - 0.5)
        total += m
        if not is_inside:
            continue
        g_t, residual = r_x * g_y - r_y * g_x, 100.0 - m
        h_xx += g_x * g_x
        h_xy += g_x * g_y
        h_xt += g_x * g_t
        h_yy += g_y * g_y
        h_yt += g_y * g_t
        h_tt += g_t * g_t
        b_x += g_x * residual
        b_y += g_y * residual
        b_t += g_t * residual
    # From percent and this level's cells to probabilities and the finest level's cells.
    h, b = (0.01 * scale) ** 2, 1e-4 * scale
    return Fit(h * h_xx, h * h_xy, h * h_xt, h * h_yy, h * h_yt, h * h_tt, b * b_x, b * b_y, b * b_t, 0.01 * total)


@njit(cache=True, error_model="numpy")
def refine_tiles(map, points, num_points, pose, prior, iterations, coarse_iterations):
    """Step to the best pose, from the coarsest level to the finest; see `refine`.

    Args:
        map: `TileMap`.
        points: shape (2, >= num_points), float32, hits in the base frame [cells].
        num_points: number of hits.
        pose: x, y from the map's corner [cells] and heading [rad] to start from.
        prior: `Prior`; its heading within half a turn of that of the start, and not wrapped.
        iterations: greatest number of steps on the finest level.
        coarse_iterations: greatest number of steps on each of the others.

    Returns:
        The pose (x, y, theta) and its `Fit` on the finest level.
    """
    x, y, theta = pose
    reach = 1.0
    for k in range(num_points):
        reach = max(reach, abs(points[0, k]) + abs(points[1, k]))
    fit = Fit(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for level in range(map.num_levels - 1, -1, -1):
        is_small, limit = False, COARSE_STEP * 2**level if level else SMALL_STEP
        for _ in range(coarse_iterations if level else iterations):
            fit = evaluate_tiles(map, level, points, num_points, x, y, theta)
            dx, dy, turn = solve(fit, prior, x, y, theta)
            x, y, theta = x + dx, y + dy, theta + min(max(turn, -MAX_TURN), MAX_TURN)
            is_small = max(abs(dx), abs(dy), abs(turn) * reach) < limit
            if is_small:
                break
        if level == 0 and not is_small:
            fit = evaluate_tiles(map, 0, points, num_points, x, y, theta)
    return x, y, theta, fit


@njit(cache=True, error_model="numpy")
def judge(map, points, num_points, x, y, theta):
    """Return the `Judgement` of a scan at a pose; arguments as those of `evaluate_tiles`."""
    c, s = math.cos(theta), math.sin(theta)
    width, height = _size(map, 0)
    num_known = total = 0
    squares = 0.0
    for k in range(num_points):
        p_x, p_y = float(points[0, k]), float(points[1, k])
        u, v = c * p_x - s * p_y + x, s * p_x + c * p_y + y
        m, _, _, _ = _interpolate(map, 0, u - 0.5, v - 0.5)
        squares += (1.0 - 0.01 * m) ** 2
        if u >= 0.0 and v >= 0.0 and u < width and v < height:
            value = int(load(map.occupancy, _cell_at(map, 0, int(v), int(u))))
            if value >= 0:
                num_known += 1
                total += value
    return Judgement(num_known, 0.01 * total / max(num_known, 1), squares)


@njit(cache=True, error_model="numpy")
def unpack_level(map, level, out):
    """Write the occupancies of a level to an array of its shape, int8, that is unknown (-1) throughout."""
    bits, start = TILE_BITS - level, level_start(level)
    side = TILE >> level
    for tile in range(map.slots.shape[0]):
        if map.slots[tile] == EMPTY:
            continue
        row, col = tile // map.tiles_wide << bits, tile % map.tiles_wide << bits
        first = map.slots[tile] * map.cells + start
        for i in range(side):
            out[row + i, col : col + side] = map.occupancy[first + i * side : first + (i + 1) * side]

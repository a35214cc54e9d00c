import math
from typing import NamedTuple, Self

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry import OccupancyGrid
from lidarnaut.envs.geometry.occupancy_grid import crop_to_known

from ..slam_params import LoopClosureParams

FULL_PERCENT = 100
"""Occupancy that counts as matching score 1 [percent]."""
UNKNOWN_PERCENT, OCCUPIED_PERCENT = 50, 65
"""Cells above these occupancies count as occupied [percent]: the first for scan points, the second for beams that cross
cells."""
LEAST_HITS = 40
"""Minimum number of scan points near known cells to judge whether a scan fits a map."""
LEAST_MAP_SHARE, LEAST_SUBMAP_SHARE = 0.6, 0.68
"""Minimum fraction of scan points near occupied cells for a scan to fit a map, or a (less distorted) submap."""
GRAZING_LENGTH = 0.3
"""Length at the end of a beam that is not tested for occupied cells [m]. Grazing beams touch wall cells before their
endpoint."""


class Field(NamedTuple):
    """Occupancy grid with its position in a map or submap frame."""

    occupancy: np.ndarray
    """Occupancies, shape (height, width), int8 [percent], -1 unknown."""
    x: float
    """x coordinate of the corner of cell (0, 0) [m]."""
    y: float
    resolution: float

    @classmethod
    def of(cls, grid: OccupancyGrid) -> Self:
        """Crop an occupancy grid to its known cells; return the whole grid if none is known."""
        known = crop_to_known(grid, margin=0)
        return cls(np.ascontiguousarray(known.data), *known.origin, known.resolution)


class HitShares(NamedTuple):
    """Agreement of scan points with an occupancy grid."""

    score: float
    """Mean occupancy at the scan points, from 0 to 1; free and unknown cells count as 0."""
    occupied: float
    """Fraction of scan points on or next to occupied cells."""
    free: float
    """Fraction of scan points in free cells without occupied neighbours."""


@njit(cache=True, error_model="numpy")
def count_hits(field, points, pose):
    """Count scan points on or next to occupied cells and in free space; also return the sum of occupied cell values.

    Free space: free cells without occupied neighbours. Values are in percent. `points`: shape (n, 2), float32, base
    frame [m]. `pose`: frame of the grid [m, m, rad].
    """
    occupancy = field.occupancy
    height, width = occupancy.shape
    x, y = (pose[0] - field.x) / field.resolution, (pose[1] - field.y) / field.resolution
    c, s = math.cos(pose[2]) / field.resolution, math.sin(pose[2]) / field.resolution
    total = occupied = free = 0
    for k in range(points.shape[0]):
        u, v = float(points[k, 0]), float(points[k, 1])
        col, row = math.floor(x + c * u - s * v), math.floor(y + s * u + c * v)
        greatest = np.int8(-1)
        for i in range(max(row - 1, 0), min(row + 2, height)):
            for j in range(max(col - 1, 0), min(col + 2, width)):
                greatest = max(greatest, occupancy[i, j])
        value = int(occupancy[row, col]) if 0 <= row < height and 0 <= col < width else -1
        if greatest > UNKNOWN_PERCENT:
            occupied += 1
            total += value if value > UNKNOWN_PERCENT else 0
        elif value >= 0:
            free += 1
    return occupied, free, total


def hit_shares(field: Field, points: np.ndarray, pose: tuple[float, float, float]) -> HitShares:
    """Return the fractions of scan points in occupied and free cells, and their mean occupancy.

    Arguments as in `count_hits`.
    """
    occupied, free, total = count_hits(field, points, tuple(pose))
    n = max(len(points), 1)
    return HitShares(total / (FULL_PERCENT * n), occupied / n, free / n)


def fits_map(
    grid: OccupancyGrid, points: np.ndarray, pose: tuple[float, float, float], least_share: float
) -> bool | None:
    """Return True if at least a fraction `least_share` of the scan points in known surroundings is near occupied cells.

    The result is None for fewer than `LEAST_HITS` such points. `points`: shape (2, n), float32, base frame [cells].
    `pose`: map frame [m, m, rad].
    """
    (x, y), side = grid.origin, grid.resolution
    in_cells = (pose[0] - x) / side, (pose[1] - y) / side, pose[2]
    occupied, free, _ = count_hits(Field(grid.data, 0.0, 0.0, 1.0), points.T, in_cells)
    return None if occupied + free < LEAST_HITS else bool(occupied >= least_share * (occupied + free))


@njit(cache=True, error_model="numpy")
def count_crossings(field, ranges, geometry, pose, least_share):
    """Return the number of lidar beams through occupied cells, and the number of tested beams.

    Only beams through mostly known cells are tested. At a wrong pose, beams cross walls. `ranges`: shape (num_beams,),
    float32 [m]. `pose`: frame of the grid [m, m, rad]. Counting stops as soon as the share of beams through occupied
    cells cannot exceed `least_share`; 0 counts all beams.
    """
    side, (height, width), flat = field.resolution, field.occupancy.shape, field.occupancy.ravel()
    c, s = math.cos(pose[2]), math.sin(pose[2])
    x = (pose[0] - field.x + c * geometry.mount_x - s * geometry.mount_y) / side
    y = (pose[1] - field.y + s * geometry.mount_x + c * geometry.mount_y) / side
    crossing = judged = 0
    for k in range(ranges.shape[0]):
        num_left = ranges.shape[0] - k
        if crossing + num_left <= least_share * (judged + num_left):
            break
        if not ranges[k] > 0.0:
            continue
        dx = c * geometry.directions[0, k] - s * geometry.directions[1, k]
        dy = s * geometry.directions[0, k] + c * geometry.directions[1, k]
        count = math.floor((min(float(ranges[k]), geometry.range_max) - GRAZING_LENGTH) / side)
        end_x, end_y, known = x + count * dx, y + count * dy, 0
        is_inside = min(x, end_x) >= 0.0 and max(x, end_x) < width and min(y, end_y) >= 0.0 and max(y, end_y) < height
        for step in range(1, count + 1):
            u, v = x + step * dx, y + step * dy
            if is_inside or (0.0 <= u < width and 0.0 <= v < height):
                value = flat[np.uint64(int(v) * width + int(u))]
                known += value >= 0
                if value > OCCUPIED_PERCENT:
                    known = count
                    crossing += 1
                    break
        judged += count > 0 and 2 * known >= count
    return crossing, judged


def is_accepted(shares: HitShares, params: LoopClosureParams) -> bool:
    """Return True if scan points agree with a map well enough for loop closure or relocalization."""
    return (
        shares.score >= params.min_score
        and shares.occupied >= params.min_occupied
        and shares.free <= params.max_free
        and shares.occupied >= params.min_agreement * (shares.occupied + shares.free)
    )


class Pyramid(NamedTuple):
    """Occupancy maxima over squares of growing size, for branch and bound (Hess et al., 2016, section V.B)."""

    levels: np.ndarray
    """Maximum occupancies, shape (num_levels, height, width), uint8 [percent], with a border of zeros. Entry (l, i, j)
    is the maximum over 2^l x 2^l cells from row i and column j on."""
    x: float
    y: float
    resolution: float
    reach: int
    """Maximum position offset along x and y in a search [cells]."""


@njit(cache=True, error_model="numpy")
def _write_greatest(a, b, c, d, out):
    for j in range(out.shape[0]):
        left = a[j] if a[j] > b[j] else b[j]
        right = c[j] if c[j] > d[j] else d[j]
        out[j] = left if left > right else right


@njit(cache=True, error_model="numpy")
def build_pyramid(field, num_levels, reach):
    """Compute occupancy maxima of a grid over squares of growing size, for branch-and-bound scan matching.

    `reach`: maximum position offset in a search [m]. Free and unknown cells count as 0.
    """
    occupancy, resolution = field.occupancy, field.resolution
    side = 1 << (num_levels - 1)
    cells = math.ceil(reach / resolution)
    # Points may move by twice the reach up and down; along a row, indices continue in the next row's border.
    rows, cols = 2 * cells + side, cells + side
    height, width = occupancy.shape[0] + 2 * rows, occupancy.shape[1] + 2 * cols
    levels = np.zeros((num_levels, height, width), dtype=np.uint8)
    for i in range(occupancy.shape[0]):
        source, target = occupancy[i], levels[0, i + rows, cols : cols + occupancy.shape[1]]
        for j in range(occupancy.shape[1]):
            target[j] = source[j] if source[j] > UNKNOWN_PERCENT else 0
    for level in range(1, num_levels):
        half = 1 << (level - 1)
        finer, coarser = levels[level - 1].ravel(), levels[level].ravel()
        for i in range(rows + 1 - 2 * half, rows + occupancy.shape[0]):
            first, last = i * width + cols + 1 - 2 * half, i * width + cols + occupancy.shape[1]
            next_first, next_last = first + half * width, last + half * width
            _write_greatest(
                finer[first:last],
                finer[first + half : last + half],
                finer[next_first:next_last],
                finer[next_first + half : next_last + half],
                coarser[first:last],
            )
    return Pyramid(levels, field.x - cols * resolution, field.y - rows * resolution, resolution, cells)

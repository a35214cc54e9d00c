"""The maps of all particles, and the occupancy grid of the best one."""

import numpy as np
from numba import njit

from envs.estimation import NO_CELLS, MapUpdate, Window
from envs.geometry import UNKNOWN
from envs.robots import LidarParams

from ..mapping.growing_map import GrowingMap
from ..mapping.log_odds_kernels import MAX_STAMP, forget_stamps, log_odds_model
from .integration import Scan, find_ends, integrate_into_maps
from .params import GMappingParams
from .proposal import Maps
from .tile_matching import TileMap, unpack_level
from .tiles import EMPTY, TILE, TILE_BITS, copy_maps, enlarge_pool, make_pool

FIRST_CAPACITY = 1024
"""Slots of a new pool; only what is written takes memory."""


@njit(cache=True, error_model="numpy")
def render_tiles(maps, particle, shown, after, occupancy, new_cells):
    """Bring an occupancy grid up to date with the map of a particle, by the tiles that differ.

    Args:
        maps: `Maps`.
        particle: number of the particle.
        shown: shape (num_tiles,), int32, written: slots whose cells the grid has.
        after: number of the last scan that the grid has.
        occupancy: shape (height, width), int8, written: percent, -1 unknown.
        new_cells: shape (n, 2), int32, written: row and column of cells that became known.

    Returns:
        Number of cells that became known; smallest and greatest column and row of the tiles that were written, the
        smallest greater than the greatest if there were none.
    """
    pool, wide = maps.pool, maps.tiles_wide
    num_new = 0
    col_min, row_min, col_max, row_max = occupancy.shape[1], occupancy.shape[0], -1, -1
    for tile in range(shown.shape[0]):
        slot = maps.slots[particle, tile]
        if slot == shown[tile] and (slot == EMPTY or pool.written[slot] <= after):
            continue
        shown[tile] = slot
        row, col = (tile // wide) << TILE_BITS, (tile % wide) << TILE_BITS
        col_min, row_min = min(col_min, col), min(row_min, row)
        col_max, row_max = max(col_max, col + TILE - 1), max(row_max, row + TILE - 1)
        for i in range(TILE):
            source, target = pool.occupancy[slot, i * TILE : (i + 1) * TILE], occupancy[row + i, col : col + TILE]
            for j in range(TILE):
                if target[j] < 0 and source[j] >= 0 and num_new < new_cells.shape[0]:
                    new_cells[num_new, 0], new_cells[num_new, 1] = row + i, col + j
                    num_new += 1
                target[j] = source[j]
    return num_new, (col_min, row_min, col_max, row_max)


@njit(cache=True, error_model="numpy")
def list_known(occupancy):
    """Return row and column of all known cells, shape (k, 2), int32, row by row."""
    count = 0
    flat = occupancy.ravel()
    for k in range(flat.shape[0]):
        count += flat[k] >= 0
    cells = np.empty((count, 2), dtype=np.int32)
    count = 0
    for row in range(occupancy.shape[0]):
        for col in range(occupancy.shape[1]):
            if occupancy[row, col] >= 0:
                cells[count, 0], cells[count, 1] = row, col
                count += 1
    return cells


class ParticleMaps(GrowingMap):
    """A map for each particle, which share tiles; `grid` is that of the particle rendered last."""

    def __init__(self, params: GMappingParams, lidar: LidarParams) -> None:
        """Make unknown maps with the map frame's origin in their middle."""
        super().__init__(
            lidar, params.resolution, (params.map_width, params.map_height), params.skip_exceeding, block=TILE
        )
        self._model = log_odds_model(params.occupied_prob, params.empty_prob, params.max_log_odds)
        self._num_levels, count = params.num_levels, params.num_particles
        self._pool = make_pool(FIRST_CAPACITY, params.num_levels)
        self._tiles = tuple(size // TILE for size in self.grid.data.shape)
        self._slots = np.full((count, self._tiles[0] * self._tiles[1]), EMPTY, dtype=np.int32)
        self._shown = np.full(self._slots.shape[1], EMPTY, dtype=np.int32)
        self._all_ends = np.empty((count, lidar.num_beams, 3))
        self._sensors = np.empty((count, 2))
        self._number = self._shown_number = 0
        self._stamp = 0

    @property
    def maps(self) -> Maps:
        """What matchers read; not valid any more once scans are integrated."""
        wide = self._tiles[1]
        return Maps(self._pool, self._slots, wide, self._num_levels, self.corner, self.grid.resolution)

    @property
    def num_tiles(self) -> int:
        """Number of tiles in memory."""
        return len(self._pool.words) - 1 - int(self._pool.num_free[0])

    def occupancy(self, particle: int, level: int = 0) -> np.ndarray:
        """Return the map of a particle at one level: shape of `grid` / 2^level, int8 [percent]."""
        maps = self.maps
        out = np.full([size >> level for size in self.grid.data.shape], UNKNOWN, dtype=np.int8)
        flat, cells = maps.pool.occupancy.ravel(), maps.pool.occupancy.shape[1]
        unpack_level(TileMap(flat, cells, maps.slots[particle], maps.tiles_wide, self._num_levels), level, out)
        return out

    def resample(self, parents: np.ndarray) -> None:
        """Replace the maps by copies of those of other particles, shape (num_particles,), int64."""
        copy_maps(self._pool, self._slots, parents)

    def integrate(self, ranges: np.ndarray, poses: np.ndarray, is_integrated: np.ndarray) -> None:
        """Integrate a scan into the maps.

        Args:
            ranges: shape (num_beams,), float32 [m].
            poses: shape (num_particles, 3), float64, of the base by particle, map frame [m, m, rad].
            is_integrated: shape (num_particles,), bool: which maps to integrate it into.
        """
        over = (ranges, self.geometry, self._skip_exceeding, poses)
        if self.grow_to_hold(*find_ends(*over, self.corner, self._all_ends, self._sensors)):
            find_ends(*over, self.corner, self._all_ends, self._sensors)
        if self._stamp == MAX_STAMP:
            forget_stamps(self._pool.words)
            self._stamp = 1
        self._stamp, self._number = self._stamp + 1, self._number + 1
        scan = Scan(self._model, self._number, self._stamp, self._num_levels)
        at = (self._tiles[1], self._all_ends, self._sensors, is_integrated, scan)
        particle = 0
        while (particle := integrate_into_maps(self._pool, self._slots, *at, particle)) < len(self._slots):
            self._pool = enlarge_pool(self._pool)

    def render(self, particle: int, is_switched: bool) -> MapUpdate:
        """Bring `grid` up to date with the map of a particle.

        Args:
            particle: number of the particle.
            is_switched: whether `grid` was of another particle; then the update says that the map was redrawn.
        """
        data, new_cells, origin = self.grid.data, self._new_cells, self.grid.origin
        count, window = render_tiles(self.maps, particle, self._shown, self._shown_number, data, new_cells)
        self._shown_number = self._number
        if is_switched:
            all_cells = Window(0, 0, data.shape[1] - 1, data.shape[0] - 1)
            return MapUpdate(list_known(data), all_cells, redrawn=True, origin=origin)
        if window[0] > window[2]:
            return MapUpdate(NO_CELLS, None)
        return MapUpdate(new_cells[:count].copy(), Window(*window), origin=origin)

    def _pad(self, margins: tuple[tuple[int, int], tuple[int, int]]) -> None:
        super()._pad(margins)
        (low, high), (left, right) = ((before // TILE, after // TILE) for before, after in margins)
        rows, cols = self._tiles
        around = ((low, high), (left, right))

        def pad(slots: np.ndarray) -> np.ndarray:
            return np.pad(slots.reshape(-1, rows, cols), ((0, 0), *around), constant_values=EMPTY)

        self._slots, self._shown = pad(self._slots).reshape(len(self._slots), -1), pad(self._shown).ravel()
        self._tiles = (rows + low + high, cols + left + right)

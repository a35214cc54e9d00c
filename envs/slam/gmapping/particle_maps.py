import math

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.estimation import NO_CELLS, MapUpdate
from lidarnaut.envs.geometry import OCCUPIED_FROM, Window
from lidarnaut.envs.robots import LidarParams

from ..growing_map import GrowingMap
from ..log_odds_map import MAX_STAMP, STAMP_BITS, LogOddsModel, forget_stamps, observe, percent
from ..scans import SIDE_START, beam_ends, walk
from ..slam_params import GMappingParams
from .proposal import Maps
from .tiles import EMPTY, TILE, TILE_BITS, copy_maps, enlarge_pool, level_start, make_pool, own_tile

FIRST_CAPACITY = 1024
ROW_BITS = 32
"""Bit position of the row in a combined cell index, row * 2^32 + column."""
_COLUMN = (1 << ROW_BITS) - 1


@njit(cache=True, error_model="numpy")
def _integrate_level(pool, index, tiles_wide, lidar, ends, model, number, stamp, level):
    bits, start, cells, scale = TILE_BITS - level, level_start(level), pool.words.shape[1], 0.5**level
    mask = (1 << bits) - 1
    # Passing arrays to a function costs more than the work for a cell or an owned tile.
    words, occupancy = pool.words.ravel(), pool.occupancy.ravel()
    references, written = pool.references, pool.written
    row_0, col_0 = math.floor(lidar[1] * scale), math.floor(lidar[0] * scale)
    for is_hit in (True, False):
        change = model.hit if is_hit else model.passed
        for k in range(ends.shape[0]):
            if math.isnan(ends[k, 0]) or (is_hit and not ends[k, 2] > 0.0):
                continue
            row_1, col_1 = math.floor(ends[k, 1] * scale), math.floor(ends[k, 0] * scale)
            base, side, length, slope, step, side_step = (row_1 << ROW_BITS) + col_1, SIDE_START, 0, 0, 0, 0
            if not is_hit:
                base = (row_0 << ROW_BITS) + col_0
                length, slope, step, side_step = walk(row_1 - row_0, col_1 - col_0, 1 << ROW_BITS)
            last_tile, first_cell = -1, 0
            for _ in range(length + 1):
                both = base + (side >> 32) * side_step
                row, col = both >> ROW_BITS, both & _COLUMN
                tile = (row >> bits) * tiles_wide + (col >> bits)
                if tile != last_tile:
                    slot = index[tile]
                    if references[slot] != 1 or written[slot] != number:
                        slot = own_tile(pool, index, tile, number)
                        if slot < 0:
                            return False
                    last_tile, first_cell = tile, slot * cells + start
                at = np.uint64(first_cell + ((row & mask) << bits) + (col & mask))
                word = words[at]
                if word & MAX_STAMP != stamp:
                    word = observe(word, change, model.bound, stamp)
                    words[at], occupancy[at] = word, percent(word >> STAMP_BITS)
                base, side = base + step, side + slope
    return True


@njit(cache=True, error_model="numpy")
def integrate_into_maps(maps, ranges, poses, geometry, model, is_integrated, number, stamp, ends, first):
    """Insert a scan into the maps of particles with `is_integrated` set, from particle `first` on.

    Returns the number of particles, or the index of the particle to continue with if the pool of map tiles is full.
    Other arguments as in `log_odds_map.integrate_scans`.
    """
    for p in range(first, maps.slots.shape[0]):
        if is_integrated[p]:
            lidar, _ = beam_ends(ranges, poses[p], geometry, maps.corner, ends)
            for level in range(maps.num_levels):
                where = (maps.pool, maps.slots[p], maps.tiles_wide, lidar, ends)
                if not _integrate_level(*where, model, number, stamp, level):
                    return p
    return maps.slots.shape[0]


@njit(cache=True, error_model="numpy")
def render_tiles(maps, particle, shown, after, occupancy, new_cells, changed_cells):
    """Copy changed tiles (square blocks of cells) of a particle's map to an occupancy grid.

    Returns the numbers of new and of changed cells, and the rectangle of changes. `shown`: slot number of each tile in
    the grid, shape (num_tiles,), int32. `after`: number of the last scan in the grid. `new_cells` and `changed_cells`
    receive row and column, as far as there is room.
    """
    pool, wide = maps.pool, maps.tiles_wide
    num_new = num_changed = 0
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
                elif (source[j] >= OCCUPIED_FROM) != (target[j] >= OCCUPIED_FROM) or (source[j] < 0 <= target[j]):
                    at = min(num_changed, changed_cells.shape[0] - 1)
                    changed_cells[at, 0], changed_cells[at, 1] = row + i, col + j
                    num_changed += 1
                target[j] = source[j]
    return (num_new, num_changed), Window(row_min, col_min, row_max - row_min + 1, col_max - col_min + 1)


class ParticleMaps(GrowingMap):
    """Maps of all particles, with shared tiles (square blocks of cells); `grid` shows the best particle's map."""

    def __init__(self, params: GMappingParams, lidar: LidarParams) -> None:
        super().__init__(params, lidar, block=TILE)
        self._model = LogOddsModel.of(params)
        self._num_levels, count = params.num_levels, params.num_particles
        self._pool = make_pool(FIRST_CAPACITY, params.num_levels)
        self._tiles = tuple(size // TILE for size in self.grid.data.shape)
        self._slots = np.full((count, self._tiles[0] * self._tiles[1]), EMPTY, dtype=np.int32)
        self._shown = np.full(self._slots.shape[1], EMPTY, dtype=np.int32)
        self._number = self._shown_number = 0
        self._stamp = 0

    @property
    def maps(self) -> Maps:
        """Maps of all particles for scan matching, invalid after the next inserted scan."""
        return Maps(self._pool, self._slots, self._tiles[1], self._num_levels, self.corner, self.grid.resolution)

    def occupancy(self, particle: int, level: int = 0) -> np.ndarray:
        """Return a particle's map at one resolution, shape (height, width) / 2^level, int8 [percent]."""
        start, side = level_start(level), TILE >> level
        tiles = self._pool.occupancy[self._slots[particle], start : start + side * side]
        by_row = tiles.reshape(*self._tiles, side, side).swapaxes(1, 2)
        return by_row.reshape(self._tiles[0] * side, self._tiles[1] * side)

    def resample(self, parents: np.ndarray) -> None:
        """Replace each particle's map by a copy of its parent's map."""
        copy_maps(self._pool, self._slots, parents)

    def integrate(self, ranges: np.ndarray, poses: np.ndarray, is_integrated: np.ndarray) -> None:
        """Insert a scan, shape (num_beams,), float32 [m], into the maps of particles with `is_integrated` set.

        `poses`: base poses, shape (num_particles, 3), map frame [m, m, rad].
        """
        self._make_room(ranges[None], poses)
        if self._stamp == MAX_STAMP:
            forget_stamps(self._pool.words)
            self._stamp = 1
        self._stamp, self._number = self._stamp + 1, self._number + 1
        scan = (ranges, poses, self.geometry, self._model, is_integrated, self._number, self._stamp, self._ends)
        particle = 0
        while (particle := integrate_into_maps(self.maps, *scan, particle)) < len(self._slots):
            self._pool = enlarge_pool(self._pool)

    def render(self, particle: int, is_switched: bool) -> MapUpdate:
        """Copy a particle's map to `grid`; return the changed cells, or all if `grid` showed another particle's map."""
        data, cells = self.grid.data, self._cells
        counts, window = render_tiles(self.maps, particle, self._shown, self._shown_number, data, *cells)
        self._shown_number = self._number
        if is_switched or counts[1] > len(self._cells[1]):
            return self.redrawn()
        if window.is_empty:
            return MapUpdate(NO_CELLS, None)
        return self._updated(window, counts)

    def _pad(self, margins: tuple[tuple[int, int], tuple[int, int]]) -> None:
        super()._pad(margins)
        (low, high), (left, right) = ((before // TILE, after // TILE) for before, after in margins)
        rows, cols = self._tiles
        tile_margins = ((low, high), (left, right))

        def pad(slots: np.ndarray) -> np.ndarray:
            return np.pad(slots.reshape(-1, rows, cols), ((0, 0), *tile_margins), constant_values=EMPTY)

        self._slots, self._shown = pad(self._slots).reshape(len(self._slots), -1), pad(self._shown).ravel()
        self._tiles = (rows + low + high, cols + left + right)

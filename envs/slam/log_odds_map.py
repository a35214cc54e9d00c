"""Log-odds occupancy maps at several resolutions.

A cell is packed into 32 bits: signed log-odds in the upper 16 (9 fractional) and, in the lower 16, the number of the
last observing scan (stamp), 0 for none. With stamps, a scan observes each cell only once.
"""

import math
from typing import NamedTuple, Self

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.estimation import MapUpdate
from lidarnaut.envs.geometry import OCCUPIED_FROM, UNKNOWN, Pose2D, Window
from lidarnaut.envs.robots import LidarParams

from .growing_map import GrowingMap, to_rows_and_columns
from .matching.distributions import NUM_SUMS, SIDE, add_points
from .scans import SIDE_START, beam_ends, walk
from .slam_params import MatchingParams

STAMP_BITS = 16
MAX_STAMP = (1 << STAMP_BITS) - 1
"""Largest scan number that a map cell can store."""
LOG_ODDS_UNIT = 1 << 9
"""Fixed-point integer for log-odds 1 (9 fractional bits)."""
_HALF = 6 * LOG_ODDS_UNIT
_PERCENTS = np.round(100.0 / (1.0 + np.exp(-np.arange(-_HALF, _HALF + 1) / LOG_ODDS_UNIT))).astype(np.int8)


class LogOddsModel(NamedTuple):
    """Inverse sensor model: log-odds that a scan adds to map cells."""

    hit: int
    """Log-odds added to a cell with a beam endpoint [units of 1/512]."""
    passed: int
    """Negative log-odds added to a cell that a beam passes [units of 1/512]."""
    bound: int
    """Maximum absolute log-odds of a cell [units of 1/512]."""

    @classmethod
    def of(cls, params: MatchingParams) -> Self:
        probs = (params.occupied_prob, params.empty_prob)
        hit, passed = (round(LOG_ODDS_UNIT * math.log(prob / (1.0 - prob))) for prob in probs)
        return cls(hit, passed, round(LOG_ODDS_UNIT * params.max_log_odds))


@njit(cache=True, error_model="numpy")
def percent(value):
    """Convert log-odds in units of 1/512 to occupancy [percent]."""
    return _PERCENTS[np.uint64(min(max(value, -_HALF), _HALF) + _HALF)]


@njit(cache=True, error_model="numpy")
def observe(word, change, bound, stamp):
    """Return a packed map cell (int32) after an observation that adds `change` to the log-odds.

    `bound`: maximum absolute log-odds. `stamp`: scan number.
    """
    value = min(max((word >> STAMP_BITS) + change, -bound), bound)
    return (value << STAMP_BITS) | stamp


@njit(cache=True, error_model="numpy")
def _integrate(words, occupancy, scale, lidar, ends, model, stamp, new_cells, changed_cells):
    """Insert a scan into one map resolution; return the numbers of new and of changed cells.

    Passing beams do not change cells with beam endpoints.
    """
    width = words.shape[1]
    flat, flat_occupancy = words.ravel(), occupancy.ravel()
    num_new = num_changed = 0
    row_0, col_0 = math.floor(lidar[1] * scale), math.floor(lidar[0] * scale)
    for is_hit in (True, False):
        change = model.hit if is_hit else model.passed
        last_row, last_col, num_seen = -1, -1, num_changed
        # Cells are listed before they are updated, because a branch for each crossing of a cell is slow.
        for k in range(ends.shape[0]):
            if math.isnan(ends[k, 0]) or (is_hit and not ends[k, 2] > 0.0):
                continue
            row_1, col_1 = math.floor(ends[k, 1] * scale), math.floor(ends[k, 0] * scale)
            if row_1 == last_row and col_1 == last_col:
                continue  # same end cell as the last beam
            last_row, last_col = row_1, col_1
            base, side, length, slope, step, side_step = row_1 * width + col_1, SIDE_START, 0, 0, 0, 0
            if not is_hit:
                base = row_0 * width + col_0
                length, slope, step, side_step = walk(row_1 - row_0, col_1 - col_0, width)
            for _ in range(length + 1):
                index = np.uint64(base + (side >> 32) * side_step)
                word = flat[index]
                changed_cells[num_seen, 0] = index
                num_seen += word & MAX_STAMP != stamp
                flat[index] = word & ~MAX_STAMP | stamp
                base, side = base + step, side + slope
        for k in range(num_changed, num_seen):
            index = np.uint64(changed_cells[k, 0])
            before, word = flat_occupancy[index], observe(flat[index], change, model.bound, stamp)
            after = percent(word >> STAMP_BITS)
            flat[index], flat_occupancy[index] = word, after
            if before < 0:
                new_cells[num_new, 0] = index
                num_new += 1
            elif (after >= OCCUPIED_FROM) != (before >= OCCUPIED_FROM):
                changed_cells[num_changed, 0] = index
                num_changed += 1
    return num_new, num_changed


@njit(cache=True, error_model="numpy")
def integrate_scans(layers, ranges, poses, geometry, corner, model, stamp, ends, cells):
    """Insert scans into a map at all resolutions; return the numbers of new and of changed cells by the last scan.

    `layers`: packed cells (int32) and occupancies (int8 [percent]), tuples of arrays, finest first; and sums, see
    `add_points`. `ranges`: shape (n, num_beams), float32 [m]. `poses`: base poses, shape (n, 3), map frame [m, m, rad].
    `stamp`: number of the first scan, higher than in all cells. `cells`: of the finest level, see
    `grid_map.integrate_scan`. See `beam_ends`.
    """
    words, levels, sums = layers
    num_new, num_changed, width = 0, 0, words[0].shape[1]
    for i in range(ranges.shape[0]):
        lidar, _ = beam_ends(ranges[i], poses[i], geometry, corner, ends)
        add_points(sums, ends)
        # The finest level comes last, because its cells are returned.
        for k in range(len(words) - 1, -1, -1):
            scan = lidar, ends, model, stamp + i
            num_new, num_changed = _integrate(words[k], levels[k], 0.5**k, *scan, cells[0], cells[1])
    to_rows_and_columns(cells[0][:num_new], width)
    to_rows_and_columns(cells[1][:num_changed], width)
    return num_new, num_changed


def forget_stamps(words: np.ndarray) -> None:
    """Replace all scan numbers in packed map cells, int32, by 1, to reuse numbers from 2."""
    for row in words:  # temporary arrays of large maps would need much memory
        np.copyto(row, row & ~MAX_STAMP | 1, where=row & MAX_STAMP > 0)


class LogOddsMap(GrowingMap):
    """Log-odds occupancy map at several resolutions for scan matching (Kohlbrecher et al., 2011, section IV.C).

    Scans are inserted into every resolution; coarse cells are not averages.
    """

    def __init__(self, params: MatchingParams, lidar: LidarParams) -> None:
        super().__init__(params, lidar, block=max(1 << (params.num_levels - 1), SIDE))
        self.model = LogOddsModel.of(params)
        self._stamp = 0
        height, width = self.grid.data.shape
        shapes = [(height >> k, width >> k) for k in range(params.num_levels)]
        self.words = [np.zeros(shape, dtype=np.int32) for shape in shapes]
        """Map cells as integers (log-odds and scan number), one array per resolution, shape (height, width) / 2^level,
        int32."""
        self._coarser = [np.full(shape, UNKNOWN, dtype=np.int8) for shape in shapes[1:]]
        self.sums = np.zeros((height // SIDE, width // SIDE, NUM_SUMS), dtype=np.float32)
        """Normal distributions of scan points, shape (height / SIDE, width / SIDE, NUM_SUMS), float32."""

    @property
    def levels(self) -> tuple[np.ndarray, ...]:
        """Occupancy grids by resolution, finest first, int8 [percent], -1 unknown."""
        return (self.grid.data, *self._coarser)

    def integrate(self, ranges: np.ndarray, pose: Pose2D) -> MapUpdate:
        """Insert a scan, shape (num_beams,), float32 [m], at a base pose, map frame."""
        return self._updated(*self.integrate_all(ranges[None], np.array([pose])))

    def integrate_all(self, ranges: np.ndarray, poses: np.ndarray) -> tuple[Window, tuple[int, int]]:
        """Insert scans, shape (n, num_beams), float32 [m], into the map; n is at most `MAX_STAMP - 1`.

        `poses`: base poses, shape (n, 3), float64, map frame. Returns the rectangle of observed cells, and the numbers
        of new and of changed cells by the last scan.
        """
        window = self._make_room(ranges, poses)
        if self._stamp + len(ranges) > MAX_STAMP:
            for words in self.words:
                forget_stamps(words)
            self._stamp = 1
        scans, work = (ranges, poses, self.geometry, self.corner), (self._ends, self._cells)
        layers = tuple(self.words), self.levels, self.sums
        counts = integrate_scans(layers, *scans, self.model, self._stamp + 1, *work)
        self._stamp += len(ranges)
        return window, counts

    def take_cells(self, other: "LogOddsMap") -> None:
        """Replace the cells by those of another map, which becomes invalid; `grid` stays the same object."""
        self.grid.data, self.grid.origin, self.corner = other.grid.data, other.grid.origin, other.corner
        self.words, self._coarser, self._stamp = other.words, other._coarser, other._stamp
        self.sums = other.sums

    def _pad(self, margins: tuple[tuple[int, int], tuple[int, int]]) -> None:
        super()._pad(margins)
        (low, high), (left, right) = margins
        for k, words in enumerate(self.words):
            narrow = ((low >> k, high >> k), (left >> k, right >> k))
            self.words[k] = np.pad(words, narrow)
            if k:
                self._coarser[k - 1] = np.pad(self._coarser[k - 1], narrow, constant_values=UNKNOWN)
        self.sums = np.pad(self.sums, ((low // SIDE, high // SIDE), (left // SIDE, right // SIDE), (0, 0)))

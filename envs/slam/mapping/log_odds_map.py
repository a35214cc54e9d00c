"""Occupancy grid maps of log odds at several resolutions."""

import numpy as np

from envs.estimation import MapUpdate, Window
from envs.geometry import UNKNOWN, Pose2D
from envs.robots import LidarParams

from ..hector_params import HectorParams
from .growing_map import GrowingMap
from .log_odds_kernels import (
    MAX_STAMP,
    forget_stamps,
    integrate_log_odds,
    integrate_scans,
    log_odds_model,
    scans_extent,
)


class LogOddsMap(GrowingMap):
    """Sums of log odds, and coarser maps of the same scans for a matcher (Kohlbrecher et al., 2011, section IV.C).

    Each level is a map by itself, with cells twice as wide as those of the one before, into which every scan is
    integrated at that resolution: coarser levels are not averages of finer ones.
    """

    def __init__(self, params: HectorParams, lidar: LidarParams) -> None:
        """Make an unknown map with the map frame's origin in its middle."""
        size, block = (params.map_width, params.map_height), 1 << (params.num_levels - 1)
        super().__init__(lidar, params.resolution, size, params.skip_exceeding, block)
        self.model = log_odds_model(params.occupied_prob, params.empty_prob, params.max_log_odds)
        self._stamp = 0
        height, width = self.grid.data.shape
        shapes = [(height >> k, width >> k) for k in range(params.num_levels)]
        self.words = [np.zeros(shape, dtype=np.int32) for shape in shapes]
        """Cells of each level, shape (height, width) / 2^level, int32; see `log_odds_kernels`."""
        self._coarser = [np.full(shape, UNKNOWN, dtype=np.int8) for shape in shapes[1:]]

    @property
    def levels(self) -> tuple[np.ndarray, ...]:
        """Occupancy in percent of each level, the finest first, int8: -1 unknown, 0 to 100; the first is `grid`'s."""
        return (self.grid.data, *self._coarser)

    def integrate(self, ranges: np.ndarray, pose: Pose2D) -> MapUpdate:
        """Integrate a scan, shape (num_beams,), float32 [m], taken at a pose of the base."""
        x, y, extent = self._make_room(ranges, pose)
        self._free_stamps(1)
        self._stamp += 1
        # The finest level comes last, since its new cells are those that count.
        for k in reversed(range(len(self.words))):
            level = self._coarser[k - 1] if k else self.grid.data
            over = (self._ends, 0.5**k, x, y, self.model, self._stamp, self._new_cells)
            count = integrate_log_odds(self.words[k], level, *over)
        return MapUpdate(self._new_cells[:count].copy(), Window(*extent), origin=self.grid.origin)

    def integrate_all(self, ranges: np.ndarray, poses: np.ndarray) -> None:
        """Integrate scans, shape (n, num_beams), float32 [m], at poses of the base, shape (n, 3), float64, map frame.

        There must be fewer than `MAX_STAMP` of them.
        """
        if len(ranges) == 0:
            return
        over = (ranges, poses, self.geometry, self._skip_exceeding)
        self.grow_to_hold(*scans_extent(*over, self.corner, self._ends))
        self._free_stamps(len(ranges))
        for k, (words, level) in enumerate(zip(self.words, self.levels)):
            work = (self.model, self._stamp + 1, self._ends, self._new_cells)
            integrate_scans((words, level, 0.5**k), *over, self.corner, *work)
        self._stamp += len(ranges)

    def take_cells(self, other: "LogOddsMap") -> None:
        """Replace the cells by those of another map of the same params, which must not be used any more.

        `grid` stays the same object.
        """
        self.grid.data, self.grid.origin, self.corner = other.grid.data, other.grid.origin, other.corner
        self.words, self._coarser, self._stamp = other.words, other._coarser, other._stamp

    def _free_stamps(self, count: int) -> None:
        """Make the next `count` numbers of scans ones that no cell holds."""
        if self._stamp + count > MAX_STAMP:
            for words in self.words:
                forget_stamps(words)
            self._stamp = 1

    def _pad(self, margins: tuple[tuple[int, int], tuple[int, int]]) -> None:
        super()._pad(margins)
        (low, high), (left, right) = margins
        for k, words in enumerate(self.words):
            narrow = ((low >> k, high >> k), (left >> k, right >> k))
            self.words[k] = np.pad(words, narrow)
            if k:
                self._coarser[k - 1] = np.pad(self._coarser[k - 1], narrow, constant_values=UNKNOWN)

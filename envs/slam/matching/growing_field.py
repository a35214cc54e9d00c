"""The field of a submap that is being built: scans are integrated one by one."""

import math

import numpy as np

from envs.geometry import Pose2D

from .submap_field import (
    MAX_SCANS,
    UNKNOWN_PERCENT,
    FieldGeometry,
    Scans,
    SensorModel,
    integrate_scan,
    percent_table,
    scan_extent,
    write_percent,
)

MARGIN = 32
"""Cells that are added beyond what a scan needs, so that not every scan enlarges the field."""


class GrowingField:
    """A field that holds, after each scan, what `render_field` would render from all of them."""

    def __init__(self, resolution: float, mount_x: float, mount_y: float, model: SensorModel) -> None:
        """Make an empty field of cells of this side [m], for a lidar at a position in the base frame [m]."""
        self._mount, self._model, self._table = (mount_x, mount_y), model, percent_table(model)
        self._words = np.zeros((0, 0), dtype=np.int32)
        self._corner = 0, 0
        self._resolution, self._count = resolution, 0
        self.field = np.zeros((0, 0), dtype=np.uint8)
        """Shape (height, width), uint8: occupancy [percent]; live, and replaced when the field grows."""

    @property
    def geometry(self) -> FieldGeometry:
        """How the cells lie in the submap's frame."""
        return FieldGeometry(self._corner[0] * self._resolution, self._corner[1] * self._resolution, self._resolution)

    def integrate(self, points: np.ndarray, pose: Pose2D) -> None:
        """Integrate a scan: hits, shape (n, 2), float32, base frame [m], and the pose in the submap's frame.

        Raises:
            ValueError: the field has `MAX_SCANS` scans already.
        """
        if self._count == MAX_SCANS:
            raise ValueError(f"a field holds at most {MAX_SCANS} scans")
        self._count += 1
        scans = Scans(points, np.array([[0, len(points)]]), np.array([pose], dtype=np.float64), *self._mount)
        cells = [math.floor(each / self._resolution) for each in scan_extent(scans)]
        # One cell more on each side, as points within rounding of a border may fall on either side of it.
        self._grow(cells[0] - 1, cells[1] - 1, cells[2] + 1, cells[3] + 1)
        integrate_scan(self._words, scans, 0, self._count, self.geometry, self._model)
        col, row = self._corner
        height, width = self.field.shape
        first = max(cells[0] - 1 - col, 0), max(cells[1] - 1 - row, 0)
        last = min(cells[2] + 1 - col, width - 1), min(cells[3] + 1 - row, height - 1)
        write_percent(self._words, self.field, (*first, *last), self._table)

    def _grow(self, col_min: int, row_min: int, col_max: int, row_max: int) -> None:
        """Enlarge the field to hold the given columns and rows, counted from the submap's origin."""
        height, width = self._words.shape
        if width == 0:
            self._corner = col_min, row_min
        col, row = self._corner
        left, low = max(col - col_min, 0), max(row - row_min, 0)
        right, high = max(col_max + 1 - col - width, 0), max(row_max + 1 - row - height, 0)
        if not (left or low or right or high):
            return
        left, low, right, high = (each + MARGIN if each else 0 for each in (left, low, right, high))
        self._words = np.pad(self._words, ((low, high), (left, right)))
        self.field = np.pad(self.field, ((low, high), (left, right)), constant_values=UNKNOWN_PERCENT)
        self._corner = col - left, row - low

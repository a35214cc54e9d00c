"""What changed in a map from sample to sample."""

from collections.abc import Sequence

import numpy as np

from envs.geometry import OccupancyGrid
from envs.navigation.frontiers import FREE_BELOW

from .recording import FREE, OCCUPIED


class MapHistory:
    """Changes of a map that may grow to any side, or be redrawn."""

    def __init__(self, grid: OccupancyGrid) -> None:
        """Begin with an unknown map; `grid` has the resolution of all that follow, and the frame."""
        self._resolution, self._first = grid.resolution, grid.origin
        # Kinds of the cells of all maps so far, and the row and column of the corner, counted from that of the first.
        self._kinds = np.zeros((0, 0), dtype=np.uint8)
        self._corner = np.zeros(2, dtype=np.int64)
        self._cells: list[np.ndarray] = []
        self._changes: list[np.ndarray] = []

    def append(self, grid: OccupancyGrid) -> None:
        """Add the map as it is now."""
        corner = np.rint(np.subtract(grid.origin, self._first)[::-1] / self._resolution).astype(np.int64)
        self._grow(corner, corner + grid.data.shape)
        now = np.zeros_like(self._kinds)
        (top, left), (height, width) = corner - self._corner, grid.data.shape
        kinds = np.where(grid.data >= FREE_BELOW, np.uint8(OCCUPIED), np.uint8(FREE))
        now[top : top + height, left : left + width] = np.where(grid.data >= 0, kinds, 0)
        changes = self._kinds ^ now
        cells = np.argwhere(changes)
        self._cells.append(cells + self._corner)
        self._changes.append(changes[tuple(cells.T)])
        self._kinds = now

    def _grow(self, low: np.ndarray, high: np.ndarray) -> None:
        """Make room for a map between two corners."""
        if not self._kinds.size:
            self._corner = low
        before = np.maximum(self._corner - low, 0)
        after = np.maximum(high - self._corner - self._kinds.shape, 0)
        if before.any() or after.any():
            self._kinds = np.pad(self._kinds, list(zip(before, after)))
            self._corner = self._corner - before

    def arrays(self) -> tuple[list[int], list[float], np.ndarray, np.ndarray, np.ndarray]:
        """Return what `Recording` holds of the map: its shape and origin, cells, changes, and ends of the samples.

        It is cut to cells that were ever known.
        """
        cells = np.concatenate(self._cells)
        low, high = (cells.min(axis=0), cells.max(axis=0) + 1) if len(cells) else (np.zeros(2, int), np.ones(2, int))
        rows, columns = (high - low).tolist()
        flat = (cells - low) @ (columns, 1)
        origin = (np.array(self._first) + low[::-1] * self._resolution).tolist()
        changes = np.concatenate(self._changes).astype(np.uint8)
        return [rows, columns], origin, flat.astype(np.int32), changes, ends_of(self._cells)


def ends_of(parts: Sequence[np.ndarray]) -> np.ndarray:
    """Return where each part ends when all are joined, shape (n,), int32."""
    return np.cumsum([0, *map(len, parts)])[1:].astype(np.int32)

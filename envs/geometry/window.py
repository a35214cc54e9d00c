"""Rectangles of grid cells."""

from collections.abc import Sequence
from typing import NamedTuple


class Window(NamedTuple):
    """Rectangle of grid cells: rows `row` to `row + height - 1`, columns `col` to `col + width - 1`."""

    row: int
    col: int
    height: int
    width: int

    @classmethod
    def spanning(cls, first: Sequence[int], last: Sequence[int]) -> "Window":
        """Return the rectangle between two corner cells (row, column), both included."""
        return cls(first[0], first[1], last[0] - first[0] + 1, last[1] - first[1] + 1)

    @property
    def slices(self) -> tuple[slice, slice]:
        """Slices of rows and columns that select the rectangle from a grid array."""
        return slice(self.row, self.row + self.height), slice(self.col, self.col + self.width)

    @property
    def is_empty(self) -> bool:
        return self.height <= 0 or self.width <= 0

    def union(self, other: "Window") -> "Window":
        """Return the smallest rectangle that contains both rectangles."""
        if self.is_empty or other.is_empty:
            return other if self.is_empty else self
        row, col = min(self.row, other.row), min(self.col, other.col)
        height = max(self.row + self.height, other.row + other.height) - row
        return Window(row, col, height, max(self.col + self.width, other.col + other.width) - col)

    def shifted(self, rows: int, cols: int) -> "Window":
        """Return the rectangle moved by a number of rows and columns."""
        return Window(self.row + rows, self.col + cols, self.height, self.width)

    def dilated(self, cells: int, shape: Sequence[int]) -> "Window":
        """Return the rectangle enlarged by `cells` on each side, and clipped to a grid of `shape` (rows, columns)."""
        if self.is_empty:
            return self
        row, col = max(self.row - cells, 0), max(self.col - cells, 0)
        height = min(self.row + self.height + cells, shape[0]) - row
        return Window(row, col, max(height, 0), max(min(self.col + self.width + cells, shape[1]) - col, 0))

    def blocks(self, size: int) -> "Window":
        """Return the rectangle in units of larger cells, of `size` x `size` grid cells each, rounded outwards."""
        row, col = self.row // size, self.col // size
        height = (self.row + self.height - 1) // size - row + 1
        return Window(row, col, height, (self.col + self.width - 1) // size - col + 1)


NO_WINDOW = Window(0, 0, 0, 0)

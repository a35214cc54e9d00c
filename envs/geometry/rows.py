"""Rows of arrays: assignment in Numba functions, and arrays with appendable rows."""

import numpy as np
from numpy.typing import ArrayLike, DTypeLike

from lidarnaut.envs.compilation import njit


@njit(cache=True, error_model="numpy")
def write_row(row, values):
    """Copy numbers to the start of an array row. Compiles faster than slice assignment."""
    for k in range(len(values)):
        row[k] = values[k]


class GrowingArray:
    """Array with appendable rows, whose capacity doubles when full."""

    def __init__(self, row_shape: tuple[int, ...], dtype: DTypeLike, capacity: int) -> None:
        self._rows = np.zeros((capacity, *row_shape), dtype=dtype)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def append(self, row: ArrayLike) -> int:
        if self._count == len(self._rows):
            self._rows = np.concatenate([self._rows, np.zeros_like(self._rows)])
        self._rows[self._count] = row
        self._count += 1
        return self._count - 1

    @property
    def rows(self) -> np.ndarray:
        return self._rows[: self._count]

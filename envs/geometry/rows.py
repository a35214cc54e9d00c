"""Assignment to array rows in Numba functions."""

from numba import njit


@njit(cache=True, error_model="numpy")
def write_row(row, values):
    """Copy numbers to the start of an array row. Compiles faster than slice assignment."""
    for k in range(len(values)):
        row[k] = values[k]

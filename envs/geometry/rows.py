"""Assignment to array rows in kernels."""

from numba import njit


@njit(cache=True, error_model="numpy")
def write_row(row, values):
    """Copy an array or a tuple of numbers to the start of a row; compiles faster than slice assignment."""
    for k in range(len(values)):
        row[k] = values[k]

"""Rows of arrays, in kernels."""

from numba import njit


@njit(cache=True, error_model="numpy")
def write_row(row, values):
    """Write values, an array or a tuple of numbers of one type, to the first entries of a row.

    One by one: to assign rows and slices, Numba compiles the texts of its errors, which takes longer than most kernels.
    """
    for k in range(len(values)):
        row[k] = values[k]

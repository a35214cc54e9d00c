"""Cholesky factorisation of symmetric 3 x 3 block matrices in skyline storage.

Block row i stores its lower triangle from the first nonzero block `first[i]`, as three scalar rows of `3 * (i + 1 -
first[i])` numbers from `starts[i]` (George and Liu, Computer Solution of Large Sparse Positive Definite Systems, 1981,
chapter 4). The fixed order of sums gives equal results on all processors.
"""

import math

import numpy as np

from lidarnaut.envs.compilation import njit

LEAST_PIVOT = 1e-11
"""Pivot, divided by the diagonal entry, below which an unknown is undetermined."""


def row_starts(first: np.ndarray) -> np.ndarray:
    """Return start indices of block rows in skyline storage, and the total length, shape (n + 1,), int64.

    `first`: index of the first nonzero block of each row.
    """
    return np.concatenate([[0], np.cumsum(9 * (np.arange(len(first)) + 1 - first))])


@njit(cache=True, error_model="numpy")
def _subtract_products(values, a, width_a, b, width_b, count, block):
    s00, s01, s02 = 0.0, 0.0, 0.0
    s10, s11, s12 = 0.0, 0.0, 0.0
    s20, s21, s22 = 0.0, 0.0, 0.0
    for k in range(count):
        a0, a1, a2 = values[a + k], values[a + width_a + k], values[a + 2 * width_a + k]
        b0, b1, b2 = values[b + k], values[b + width_b + k], values[b + 2 * width_b + k]
        s00, s01, s02 = s00 + a0 * b0, s01 + a0 * b1, s02 + a0 * b2
        s10, s11, s12 = s10 + a1 * b0, s11 + a1 * b1, s12 + a1 * b2
        s20, s21, s22 = s20 + a2 * b0, s21 + a2 * b1, s22 + a2 * b2
    block[0, 0] -= s00
    block[0, 1] -= s01
    block[0, 2] -= s02
    block[1, 0] -= s10
    block[1, 1] -= s11
    block[1, 2] -= s12
    block[2, 0] -= s20
    block[2, 1] -= s21
    block[2, 2] -= s22


@njit(cache=True, error_model="numpy")
def _factorise_diagonal(block, diagonal):
    for r in range(3):
        for q in range(r):
            for k in range(q):
                block[r, q] -= block[r, k] * block[q, k]
            block[r, q] /= block[q, q]
            block[r, r] -= block[r, q] * block[r, q]
        if block[r, r] > LEAST_PIVOT * diagonal[r]:
            block[r, r] = math.sqrt(block[r, r])
        else:
            block[r, r] = np.inf


@njit(cache=True, error_model="numpy")
def factorise(values, first, starts):
    """Factorise a positive semidefinite matrix in place (Cholesky).

    `values`: skyline storage, shape (starts[n],), float64. `starts`: start indices from `row_starts`.
    """
    block, diagonal = np.empty((3, 3)), np.empty(3)
    for i in range(first.shape[0]):
        width = 3 * (i + 1 - first[i])
        for j in range(first[i], i + 1):
            at = starts[i] + 3 * (j - first[i])
            for r in range(3):
                for q in range(3):
                    block[r, q] = values[at + r * width + q]
            common = max(first[i], first[j])
            other_width = 3 * (j + 1 - first[j])
            row, other = starts[i] + 3 * (common - first[i]), starts[j] + 3 * (common - first[j])
            for r in range(3):
                diagonal[r] = block[r, r]
            _subtract_products(values, row, width, other, other_width, 3 * (j - common), block)
            if i == j:
                _factorise_diagonal(block, diagonal)
            else:
                end = starts[j] + 3 * (j - first[j])
                for r in range(3):
                    for q in range(3):
                        for k in range(q):
                            block[r, q] -= block[r, k] * values[end + q * other_width + k]
                        block[r, q] /= values[end + q * other_width + q]
            for r in range(3):
                for q in range(3):
                    values[at + r * width + q] = block[r, q]


@njit(cache=True, error_model="numpy")
def solve(values, first, starts, x):
    """Solve a factorised linear system: replace right-hand side `x`, shape (3 n,), float64, by the solution.

    Undetermined unknowns are 0.
    """
    n = first.shape[0]
    for i in range(n):
        width = 3 * (i + 1 - first[i])
        for r in range(3):
            row = starts[i] + r * width - 3 * first[i]
            total = x[3 * i + r]
            for k in range(3 * first[i], 3 * i + r):
                total -= values[row + k] * x[k]
            x[3 * i + r] = total / values[row + 3 * i + r]
    for i in range(n - 1, -1, -1):
        width = 3 * (i + 1 - first[i])
        for r in range(2, -1, -1):
            row = starts[i] + r * width - 3 * first[i]
            x[3 * i + r] /= values[row + 3 * i + r]
            for k in range(3 * first[i], 3 * i + r):
                x[k] -= values[row + k] * x[3 * i + r]

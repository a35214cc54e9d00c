import numpy as np
import pytest

from envs.slam.posegraph.skyline import factorise, row_starts, solve


def skyline(matrix, first):
    starts = row_starts(first)
    values = np.zeros(starts[-1])
    for i in range(len(first)):
        rows = matrix[3 * i : 3 * i + 3, 3 * first[i] : 3 * i + 3]
        values[starts[i] : starts[i + 1]] = rows.ravel()
    return values, starts


def random_matrix(rng, first):
    """Return a positive definite matrix that is zero in front of the first block of each row."""
    factor = np.zeros((3 * len(first), 3 * len(first)))
    for i in range(len(first)):
        factor[3 * i : 3 * i + 3, 3 * first[i] : 3 * i + 3] = rng.normal(size=(3, 3 * (i + 1 - first[i])))
    factor = np.tril(factor) + 3.0 * np.eye(len(factor))
    return factor @ factor.T


@pytest.mark.parametrize("first", [[0], [0, 0, 1, 2], [0, 1, 1, 0, 3, 2], [0, 1, 2]])
def test_solution_equals_that_of_numpy(first):
    rng = np.random.default_rng(len(first))
    first = np.array(first)
    matrix = random_matrix(rng, first)
    values, starts = skyline(matrix, first)
    rhs = rng.normal(size=len(matrix))
    x = rhs.copy()
    assert factorise(values, first, starts) == 0
    solve(values, first, starts, x)
    np.testing.assert_allclose(x, np.linalg.solve(matrix, rhs), rtol=1e-9, atol=1e-12)


def test_unknowns_that_nothing_determines_are_zero():
    rng = np.random.default_rng(0)
    first = np.array([0, 0, 0])
    matrix = random_matrix(rng, first)
    matrix[3:6] = matrix[:, 3:6] = 0.0  # nothing is known of the second block
    values, starts = skyline(matrix, first)
    rhs = rng.normal(size=9)
    rhs[3:6] = 0.0
    x = rhs.copy()
    assert factorise(values, first, starts) == 3
    solve(values, first, starts, x)
    known = [0, 1, 2, 6, 7, 8]
    np.testing.assert_allclose(x[known], np.linalg.solve(matrix[np.ix_(known, known)], rhs[known]), rtol=1e-9)
    assert (x[3:6] == 0.0).all()

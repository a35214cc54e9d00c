"""The area estimator: a beam's observation of a cell follows from where it crosses it."""

from numba import njit


@njit(cache=True, error_model="numpy")
def area_below(a, b, c):
    """Return the area of the part of the unit square where a x + b y <= c, with a, b not both zero.

    The half-plane is mirrored such that a, b >= 0; then it is a triangle minus the corners of it that stick out.
    """
    if a < 0.0:
        a, c = -a, c - a
    if b < 0.0:
        b, c = -b, c - b
    if c <= 0.0:
        return 0.0
    if c >= a + b:
        return 1.0
    # Too steep for the triangle: the line runs along an edge of the square.
    if a < 1e-9 * b:
        return c / b
    if b < 1e-9 * a:
        return c / a
    right, top = max(c - a, 0.0), max(c - b, 0.0)
    return (c * c - right * right - top * top) / (2.0 * a * b)


@njit(cache=True, error_model="numpy")
def share_behind_hit(row, col, hit_x, hit_y, dir_x, dir_y):
    """Return the share of a cell that lies behind the line through a hit [cells], perpendicular to its beam.

    The direction of the beam, (dir_x, dir_y), has any length.
    """
    return 1.0 - area_below(dir_x, dir_y, dir_x * (hit_x - col) + dir_y * (hit_y - row))


@njit(cache=True, error_model="numpy")
def share_cut_off(row, col, x, y, dir_x, dir_y):
    """Return the smaller of the two parts into which the line of a beam through (x, y) [cells] cuts a cell.

    One half for a cell that the line misses, which happens since beams are walked from cell centre to cell centre.
    """
    share = area_below(-dir_y, dir_x, dir_x * (y - row) - dir_y * (x - col))
    share = min(share, 1.0 - share)
    return share if share > 0.0 else 0.5

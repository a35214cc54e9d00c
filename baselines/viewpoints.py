"""Where to stand to look at a frontier."""

import numpy as np

from envs.navigation import TravelField, cheapest_view


def find_viewpoint(field: TravelField, cells: np.ndarray, reach: float) -> tuple[tuple[int, int], int] | None:
    """Find the place that is cheapest to get to among those near enough to see one of some cells.

    Args:
        field: travel from where the robot is.
        cells: shape (k, 2), int64, (row, column) of what to see.
        reach: distance from which to see it [m]; 0 for standing on it.

    Returns:
        The place (row, column) and the index of the cell that is seen from there; None if none can be reached.
    """
    grid = field.costmap.grid
    row, col, seen = cheapest_view(grid.data, field.travel, cells, int(reach / grid.resolution + 1e-9))
    return None if seen < 0 else ((row, col), seen)

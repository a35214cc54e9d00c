"""Right of way: which robot is on whose path, and where one waits for another to pass."""

import math

import numpy as np

from envs.geometry import Pose2D
from envs.geometry.polyline import lengths_along
from envs.navigation import TravelField
from envs.navigation.costmap import squared_distances

PASSING_CLEARANCE = 0.15
"""Gap between the footprints of a robot that passes and of one that waits [m]."""
OUTLINE_POINTS = 16
"""Points on the outline of a peer."""


def outline(pose: Pose2D, peer: Pose2D, radius: float) -> np.ndarray:
    """Return the outline of a peer, of a radius [m], as obstacles: shape (16, 2), float64, the robot's base frame [m].

    The poses of the robot and of the peer are those in the map frame.
    """
    away = pose.between(peer)
    angles = np.linspace(0.0, 2.0 * math.pi, OUTLINE_POINTS, endpoint=False)
    return np.array(away[:2]) + radius * np.column_stack([np.cos(angles), np.sin(angles)])


def is_beside(position: tuple[float, float], path: np.ndarray, gap: float, reach: float = math.inf) -> bool:
    """Tell whether a position lies within `gap` [m] of the first `reach` metres of a path, shape (n, 2)."""
    if len(path) == 0:
        return False
    near = path[lengths_along(path) <= reach]
    return bool(np.hypot(*(near - position).T).min() < gap)


def find_waiting_cell(field: TravelField, path: np.ndarray, radius: float) -> tuple[int, int] | None:
    """Find where a robot waits for another one to pass: the cell (row, column) off its path that is cheapest to get to.

    `field` is the travel of the waiting robot, with the other one as an obstacle, and `path`, shape (n, 2), n > 0, that
    of the other one from its position, map frame [m]; both footprints have a radius [m]. None if there is no such cell.
    """
    grid = field.costmap.grid
    cells = grid.cells(path)
    cells = cells[grid.contains(cells)]
    on_path = np.zeros(grid.data.shape, dtype=np.bool_)
    on_path[cells[:, 0], cells[:, 1]] = True
    reach = math.ceil((2.0 * radius + PASSING_CLEARANCE) / grid.resolution)
    off_path = np.argwhere(squared_distances(on_path, reach) > reach**2)
    costs = field.cost(off_path)
    if len(costs) == 0 or math.isinf(costs.min()):
        return None
    row, col = off_path[np.argmin(costs)]
    return int(row), int(col)

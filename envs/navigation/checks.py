"""Whether a goal can be reached at all, and a path still be followed."""

import math

import numpy as np

from .astar import COST_WEIGHT, step_weights
from .costmap import COST_INSCRIBED, COST_LETHAL, COST_MAX_FREE, COST_UNKNOWN, Costmap
from .paths import nearest_cell


def is_path_valid(costmap: Costmap, path: np.ndarray, *, allow_unknown: bool = False) -> bool:
    """Tell whether a robot can follow a path: it stays inside the map and touches nothing that is known.

    Points at the start where the robot touches something in its belief already do not count, if it gets out of there.

    Args:
        costmap: the costs now.
        path: shape (n, 2), points about a cell apart [m].
        allow_unknown: whether it may cross unknown cells.
    """
    grid = costmap.grid
    cells = grid.cells(path)
    if not grid.contains(cells).all():
        return False
    costs = costmap.costs[tuple(cells.T)]
    touches = (costs == COST_INSCRIBED) | (costs == COST_LETHAL)
    is_open = (step_weights(COST_WEIGHT, allow_unknown)[costs] > 0) & ~touches
    first = int(np.argmax(is_open))
    return bool(touches[:first].all() and is_open[first:].all())


def check_goal(
    costmap: Costmap, goal: tuple[float, float], *, tolerance: float = 0.0, allow_unknown: bool = False
) -> None:
    """Make sure that a goal is traversable, or a cell near enough to it.

    Args:
        costmap: the costs now.
        goal: where to go (x, y), map frame [m].
        tolerance: how far beside the goal the robot may stop [m].
        allow_unknown: whether unknown cells count as traversable.

    Raises:
        ValueError: if it is not; the message says why.
    """
    if not all(map(math.isfinite, goal)):
        raise ValueError(f"goal must be finite, got {goal}")
    grid = costmap.grid
    row, col = (int(k) for k in grid.cells(np.array(goal)))
    reach = math.floor(tolerance / grid.resolution + 1e-9)
    weights = step_weights(COST_WEIGHT, allow_unknown)
    if nearest_cell(costmap.costs, weights, row, col, reach, COST_MAX_FREE)[0] >= 0:
        return
    name = f"goal ({goal[0]:.2f}, {goal[1]:.2f})"
    if not grid.contains(np.array([row, col])):
        raise ValueError(f"{name} lies outside the map, which covers {tuple(round(k, 2) for k in grid.bounds)}")
    cost = costmap.costs[row, col]
    if cost == COST_UNKNOWN:
        raise ValueError(f"{name} lies in unknown space, and no known free cell lies within {tolerance:g} m of it")
    if cost == COST_LETHAL:
        raise ValueError(f"{name} lies in an obstacle, and no free cell lies within {tolerance:g} m of it")
    radius = costmap.params.robot_radius
    raise ValueError(
        f"{name} lies nearer to an obstacle than the robot's {radius:.2f} m, and no cell with more clearance lies "
        f"within {tolerance:g} m of it"
    )

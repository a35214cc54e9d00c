"""Task allocation (Nguyen et al. 2022, section 2.1.3): frontier points are assigned to robots by revenue."""

import math

import numpy as np

from baselines.rrt.filter import information_gain
from baselines.rrt.params import RrtParams
from envs.geometry import OccupancyGrid
from envs.navigation import NO_POINTS

UNASSIGNED = -1
"""In place of a point, for a robot that gets none."""


def assign(
    grid: OccupancyGrid,
    robots: np.ndarray,
    points: np.ndarray,
    costs: np.ndarray,
    params: RrtParams,
    taken: np.ndarray = NO_POINTS,
) -> np.ndarray:
    """Assign points: again and again the robot and the point of the highest revenue, until either is used up.

    The revenue is R = lambda h(x_fp, x_r) I(x_fp) - N(x_fp), with lambda = `info_multiplier`, and h = `hysteresis_gain`
    within `hysteresis_radius` and 1 beyond, so that a robot finishes what is around it first. What a robot will see at
    its point is no gain for the others: unknown cells within `info_radius` of both points do not count any more.

    Args:
        grid: the map that the robots share.
        robots: shape (n, 2), float64, positions x_r, map frame [m].
        points: shape (m, 2), float64, frontier points x_fp, map frame [m].
        costs: shape (n, m), float64, navigation costs N [m]; inf where a robot cannot reach a point.
        params: of the revenue.
        taken: shape (k, 2), float64, points that other robots have already, map frame [m].

    Returns:
        Shape (n,), int64: index of each robot's point; `UNASSIGNED` where none is left that it can reach.

    Raises:
        ValueError: `costs` does not have a row for each robot and a column for each point.
    """
    if costs.shape != (len(robots), len(points)):
        raise ValueError(f"costs must have the shape {(len(robots), len(points))} (robots, points), got {costs.shape}")
    chosen = np.full(len(robots), UNASSIGNED, dtype=np.int64)
    gains = information_gain(grid, points, params.info_radius)
    for point in taken:
        gains = gains - information_gain(grid, points, params.info_radius, shared_with=point)
    gaps = robots[:, None] - points[None]
    is_near = np.hypot(gaps[..., 0], gaps[..., 1]) <= params.hysteresis_radius
    factors = params.info_multiplier * np.where(is_near, params.hysteresis_gain, 1.0)
    open_costs = costs.astype(np.float64)
    for _ in range(min(len(robots), len(points))):
        revenues = factors * gains - open_costs
        robot, point = np.unravel_index(np.argmax(revenues), revenues.shape)
        if math.isinf(revenues[robot, point]):
            break
        chosen[robot] = point
        gains = gains - information_gain(grid, points, params.info_radius, shared_with=points[point])
        open_costs[robot] = open_costs[:, point] = np.inf
    return chosen

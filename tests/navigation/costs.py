from lidarnaut.envs.navigation import COST_UNKNOWN


def cost_at(costmap, x, y):
    """Cost at a position in the grid's frame [m]; unknown outside."""
    row, col = costmap.grid.cells((x, y))
    height, width = costmap.costs.shape
    return int(costmap.costs[row, col]) if 0 <= row < height and 0 <= col < width else COST_UNKNOWN

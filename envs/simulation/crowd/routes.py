"""Destinations of pedestrians, and cost-to-go fields."""

import math
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.worlds import World
from lidarnaut.envs.worlds.raster import rasterize
from lidarnaut.envs.worlds.world import kept_with_world

from . import person_row as at
from .walls import WALL_RANGE, Walls, clearance, list_walls

RESOLUTION = 0.15
"""Cell size of pedestrian cost-to-go fields [m]."""
NUM_DESTINATIONS = 8
"""Number of destinations of a crowd with `flow="anywhere"`."""
STRIP_WIDTH = 0.5
"""Maximum depth of a destination that extends along a side of the world, for `flow="along"` or `"across"` [m]."""
ARRIVAL_DISTANCE = 0.5
"""Cost-to-go below which a person has reached the destination [m]."""
MEAN_STUCK_TIME = 3.0
"""Mean time of slow walking before a person changes the destination [s]. Individual times vary by 50 %."""
SLOW_FRACTION = 0.2
"""A person makes slow progress below this fraction of the desired walking speed."""
NEXT_BY_DRAW = -1.0
"""Index of the next destination in `Routes.points` that stands for a destination drawn at random."""
_PRECISION = 1e-3
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)
_WALL_COST, _FREE_CLEARANCE = 3.0, 0.25
"""Extra walking cost per metre for a person touching a wall (open space costs 1), and gap to the wall that costs
nothing extra [m]."""
_OUTSIDE_COST = 8.0
"""Walking cost per metre in free cells that are too narrow for a person or unreachable; open space costs 1."""

Costs = tuple[np.ndarray, np.ndarray]


class Routes(NamedTuple):
    """Destinations of pedestrians in a world, walking cost to each, and free space."""

    points: np.ndarray
    """Destinations, shape (k, 3), float64: x, y in the world frame [m], and index of the next destination or -1
    (random)."""
    fields: np.ndarray
    """Cost-to-go from each cell to each destination, shape (k, height, width), float32 [m]; inf in obstacles."""
    room: np.ndarray
    """Centres (x, y) of connected cells that have room for a person, shape (n, 2), float64, world frame [m]."""
    walls: Walls
    """Lookup table of static obstacles. Its grid has the same origin as `fields`."""


@kept_with_world
def plan_routes(world: World, radius: float, flow: str) -> Routes:
    """Compute destinations and cost-to-go fields of a crowd in a world.

    `radius`: radius of the largest person [m]. `flow`: walking directions, see `Crowd`. ValueError if people of this
    radius do not fit into the world.
    """
    grid = rasterize(world, RESOLUTION)
    walls = list_walls(world.segments, world.circles, grid.bounds, radius)
    free = grid.data == 0
    gaps = np.minimum(_clearances(free, walls), radius + WALL_RANGE)
    # Narrow doors may have no cell centre with full clearance.
    labels, _ = ndimage.label(gaps > radius - 0.25 * RESOLUTION)
    spawn = np.array(world.spawns[0][:2])
    cells = np.argwhere(labels > 0)
    if not len(cells):
        raise ValueError(f"world {world.name!r} has no room for people of a radius of {radius:g} m")
    nearest = cells[np.argmin(np.hypot(*(grid.centers(cells) - spawn).T))]
    fits = labels == labels[tuple(nearest)]
    beside_walls = np.clip(1.0 - (gaps - radius) / _FREE_CLEARANCE, 0.0, 1.0)
    slowness = np.where(fits, 1.0 + _WALL_COST * beside_walls, np.inf)
    outside = np.where(fits | ~free, np.inf, _OUTSIDE_COST)
    slowness[[0, -1]] = slowness[:, [0, -1]] = outside[[0, -1]] = outside[:, [0, -1]] = np.inf
    costs = slowness.astype(np.float32), outside.astype(np.float32)
    if flow == "anywhere":
        where, fields = _spread(fits, gaps, costs, nearest)
        following = np.full(len(where), NEXT_BY_DRAW)
    else:
        where, fields = _strips(fits, costs, flow)
        following = np.arange(len(where)) ^ 1
    points = np.column_stack([grid.centers(where), following])
    return Routes(points, fields, grid.centers(np.argwhere(fits)), walls)


def _spread(fits: np.ndarray, gaps: np.ndarray, costs: Costs, first: np.ndarray) -> tuple[np.ndarray, ...]:
    roomy = np.argwhere(fits & (gaps >= np.quantile(gaps[fits], 0.6)))
    k = int(np.argmin(np.hypot(*(roomy - first).T)))
    chosen: list[np.ndarray] = []
    fields: list[np.ndarray] = []
    nearest = np.full(len(roomy), np.inf)
    apart = RESOLUTION * math.sqrt(np.count_nonzero(fits) / NUM_DESTINATIONS)
    rows, cols = np.ogrid[: fits.shape[0], : fits.shape[1]]
    while len(chosen) < min(NUM_DESTINATIONS, len(roomy)):
        row, col = roomy[k]
        distances = RESOLUTION * np.hypot(rows - row, cols - col)
        fields.append(_travel(costs, np.where(distances <= gaps[row, col], distances, np.inf)))
        chosen.append(roomy[k])
        nearest = np.minimum(nearest, fields[-1][roomy[:, 0], roomy[:, 1]])
        far = np.flatnonzero(nearest >= min(apart, nearest.max()))
        k = int(far[int(len(chosen) * _GOLDEN % 1.0 * len(far))])
    return np.array(chosen), np.array(fields)


def _strips(fits: np.ndarray, costs: Costs, flow: str) -> tuple[np.ndarray, ...]:
    cells = np.argwhere(fits)
    extents = np.ptp(cells, axis=0)
    chosen, fields = [], []
    for axis in (0, 1) if flow == "across" else (int(np.argmax(extents)),):
        width = min(STRIP_WIDTH / RESOLUTION, 0.25 * extents[axis])
        for distances in (cells[:, axis] - cells[:, axis].min(), cells[:, axis].max() - cells[:, axis]):
            strip = cells[distances <= width]
            chosen.append(strip[np.argmin(np.hypot(*(strip - strip.mean(axis=0)).T))])
            field = np.full(fits.shape, np.inf)
            field[strip[:, 0], strip[:, 1]] = 0.0
            fields.append(_travel(costs, field))
    return np.array(chosen), np.array(fields)


def _travel(costs: Costs, field: np.ndarray) -> np.ndarray:
    field = field.astype(np.float32)
    for slowness in costs:
        spread_costs(slowness, field)
    return field


@njit(cache=True, error_model="numpy")
def spread_costs(slowness, field):
    """Compute the cost-to-go of all cells by solving the eikonal equation |grad field| = slowness.

    Fast sweeping (Zhao, 2005; Bak et al., 2010), also along diagonals.

    Args:
        slowness: cost per metre, shape (height, width), float32; inf in obstacles and on the border.
        field: cost-to-go, shape (height, width), float32 [m], updated; at first inf where unknown.
    """
    height, width = field.shape
    is_open = np.zeros((height, width), dtype=np.bool_)
    for row in range(1, height - 1):
        for col in range(1, width - 1):
            if field[row, col] < np.inf:
                is_open[row - 1 : row + 2, col - 1 : col + 2] = True
    changed = True
    while changed:
        changed = False
        for sweep in range(4):
            for step_row in range(1, height - 1):
                row = step_row if sweep < 2 else height - 1 - step_row
                for step_col in range(1, width - 1):
                    col = step_col if sweep % 2 == 0 else width - 1 - step_col
                    if is_open[row, col]:
                        is_open[row, col] = False
                        value = _solve(slowness, field, row, col)
                        if value < field[row, col] - np.float32(_PRECISION):
                            field[row, col] = value
                            changed = True
                            for r in range(row - 1, row + 2):
                                for c in range(col - 1, col + 2):
                                    is_open[r, c] = True


@njit(cache=True, error_model="numpy", inline="always")
def _solve(slowness, field, row, col):
    cost = np.float32(RESOLUTION) * slowness[row, col]
    up_down = min(field[row - 1, col], field[row + 1, col])
    sides = min(field[row, col - 1], field[row, col + 1])
    rising = min(field[row - 1, col - 1], field[row + 1, col + 1])
    falling = min(field[row - 1, col + 1], field[row + 1, col - 1])
    return min(_upwind(up_down, sides, cost), _upwind(rising, falling, np.float32(math.sqrt(2.0)) * cost))


@njit(cache=True, error_model="numpy", inline="always")
def _upwind(a, b, cost):
    low, high = min(a, b), max(a, b)
    if not high < low + cost:
        return low + cost
    return np.float32(0.5 * (float(low + high) + math.sqrt(2.0 * float(cost) * float(cost) - float((high - low) ** 2))))


@njit(cache=True, error_model="numpy")
def _clearances(free, walls):
    gaps, (near, grid) = np.zeros(free.shape), walls
    for row in range(free.shape[0]):
        for col in range(free.shape[1]):
            if free[row, col]:
                x, y = grid[0] + (col + 0.5) * RESOLUTION, grid[1] + (row + 0.5) * RESOLUTION
                gaps[row, col] = clearance(near, grid, x, y)
    return gaps


@njit(cache=True, error_model="numpy", inline="always")
def descent(fields, k, grid, x, y):
    """Return the unit vector of steepest descent of cost-to-go field `k` at (x, y), and the cost-to-go [m]."""
    across, up = (x - grid[0]) / RESOLUTION - 0.5, (y - grid[1]) / RESOLUTION - 0.5
    row, col = min(max(int(up), 0), fields.shape[1] - 2), min(max(int(across), 0), fields.shape[2] - 2)
    across, up = across - col, up - row
    a, b = float(fields[k, row, col]), float(fields[k, row, col + 1])
    c, d = float(fields[k, row + 1, col]), float(fields[k, row + 1, col + 1])
    if not max(max(a, b), max(c, d)) < np.inf:
        top = -np.inf
        for value in (a, b, c, d):
            top = max(top, value if value < np.inf else -np.inf)
        if top == -np.inf:
            return 0.0, 0.0, np.inf
        a, b, c, d = min(a, top + 1.0), min(b, top + 1.0), min(c, top + 1.0), min(d, top + 1.0)
    gx, gy = (1.0 - up) * (b - a) + up * (d - c), (1.0 - across) * (c - a) + across * (d - b)
    slope = math.sqrt(gx * gx + gy * gy)
    value = (1.0 - up) * ((1.0 - across) * a + across * b) + up * ((1.0 - across) * c + across * d)
    return (-gx / slope, -gy / slope, value) if slope > 0.0 else (0.0, 0.0, value)


@njit(cache=True, error_model="numpy")
def choose_directions(people, points, fields, grid, dt, directions):
    """Compute walking directions of the crowd. People that have arrived or are stuck get new destinations.

    `people`: state vectors, updated. `points`, `fields`: destinations, and cost-to-go to each. `grid`: origin (x, y) of
    `fields` [m]. `dt`: time step [s]. `directions`: output, shape (n, 2), float64, unit vectors.
    """
    first = points.shape[0] - fields.shape[0]
    for i in range(people.shape[0]):
        directions[i, 0] = directions[i, 1] = 0.0
        if people[i, at.KIND] > at.BLIND:
            continue
        for _ in range(2):
            goal = int(people[i, at.GOAL])
            ahead_x, ahead_y, cost = descent(fields, goal - first, grid, people[i, at.X], people[i, at.Y])
            draw = people[i, at.DRAWS + int(people[i, at.TRIP]) % at.NUM_DRAWS]
            if cost > ARRIVAL_DISTANCE and people[i, at.SLOW] < MEAN_STUCK_TIME * (0.5 + draw):
                break
            away = (ahead_x, ahead_y) if cost > ARRIVAL_DISTANCE else (0.0, 0.0)
            people[i, at.GOAL] = _next_goal(people[i], goal, draw, points, fields, grid, away)
            people[i, at.TRIP] += 1.0
            people[i, at.SLOW] = 0.0
        directions[i, 0], directions[i, 1] = ahead_x, ahead_y
        progress = people[i, at.VX] * ahead_x + people[i, at.VY] * ahead_y
        people[i, at.SLOW] = people[i, at.SLOW] + dt if progress < SLOW_FRACTION * people[i, at.SPEED] else 0.0


@njit(cache=True, error_model="numpy")
def _next_goal(person, goal, draw, points, fields, grid, away):
    count = fields.shape[0]
    first = points.shape[0] - count
    if points[goal, 2] != NEXT_BY_DRAW:
        return int(points[goal, 2])
    drawn = goal - first + 1 + int(draw * (count - 1))
    for k in range(drawn, drawn + count):
        x, y, cost = descent(fields, k % count, grid, person[at.X], person[at.Y])
        if x * away[0] + y * away[1] < 0.0 and cost > ARRIVAL_DISTANCE:
            return first + k % count
    return first + drawn % count

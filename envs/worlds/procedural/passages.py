import math

import numpy as np

from ..raster import outline
from ..world import World, box, edges
from .plan import UNIT, Point, Size, units, with_goals, world_within

_GAP = 1.0
"""Minimum gap between obstacles, and between obstacles and walls [m]."""
_WALL = 0.1
"""Thickness of the outer walls [m]."""
_END_DISTANCE = 1.0
"""Distance of starts and goals from the nearest wall [m]."""

Area = tuple[float, float, float, float]
"""Rectangle (x0, y0, x1, y1) [m]."""


def build_hall(name: str, rng: np.random.Generator, size: Size) -> World:
    """Return a hall of the given outer size [m], with pillars and boxes."""
    width, height = size
    start, goal = ((x, _somewhere(rng, 0.0, height)) for x in (_END_DISTANCE, width - _END_DISTANCE))
    number = round(width * height / rng.uniform(12.0, 30.0))
    bodies = _scatter(rng, (0.0, 0.0, width, height), number, [start, goal])
    return with_goals(world_within(name, size, rng, start, *bodies), [(start, goal), (goal, start)])


def build_corridor(name: str, rng: np.random.Generator, size: Size) -> World:
    """Return a corridor along the longer side of the given outer size [m], with niches in its walls."""
    turned = size[1] > size[0]
    length, width = max(size), min(size)
    depth = rng.uniform(0.5, 0.8)
    low, high = _WALL + depth, width - _WALL - depth
    areas = [(_WALL, low, length - _WALL, high)]
    for bottom, top in ((_WALL, low), (high, width - _WALL)):
        for _ in range(int(rng.integers(4))):
            span = rng.uniform(0.8, 2.5)
            x = rng.uniform(_WALL, length - _WALL - span)
            areas.append((x, bottom, x + span, top))
    start, goal = ((x, _somewhere(rng, low, high)) for x in (_WALL + _END_DISTANCE, length - _WALL - _END_DISTANCE))
    if turned:
        areas = [(y0, x0, y1, x1) for x0, y0, x1, y1 in areas]
        start, goal = start[::-1], goal[::-1]
    walls = _walls_around(size, areas)
    return with_goals(world_within(name, size, rng, start, walls, np.empty((0, 3))), [(start, goal), (goal, start)])


def build_doorway(name: str, rng: np.random.Generator, size: Size) -> World:
    """Return two rooms of the given outer size [m], joined by a door 1.0 to 1.6 m wide."""
    width, height = size
    middle, half, door = width * rng.uniform(0.4, 0.6), rng.uniform(0.05, 0.1), rng.uniform(1.0, 1.6)
    y = rng.uniform(0.3, height - 0.3 - door)
    rooms = [(_WALL, _WALL, middle - half, height - _WALL), (middle + half, _WALL, width - _WALL, height - _WALL)]
    walls = _walls_around(size, [*rooms, (middle - half, y, middle + half, y + door)])
    start, goal = ((x, _somewhere(rng, 0.0, height)) for x in (_WALL + _END_DISTANCE, width - _WALL - _END_DISTANCE))
    ends, posts = zip(rooms, (start, goal)), ((middle, y), (middle, y + door))
    bodies = [_scatter(rng, room, int(rng.integers(3)), [point, *posts]) for room, point in ends]
    segments, circles = (np.vstack(parts) for parts in zip(*bodies))
    world = world_within(name, size, rng, start, np.vstack([walls, segments]), circles)
    return with_goals(world, [(start, goal), (goal, start)])


def build_crossing(name: str, rng: np.random.Generator, size: Size) -> World:
    """Return two crossing corridors of the given outer size [m], 3 to 4.5 m wide."""
    (x0, x1), (y0, y1) = (_strip(rng, side) for side in size)
    width, height = size
    areas = [(_WALL, y0, width - _WALL, y1), (x0, _WALL, x1, height - _WALL)]
    west, east = ((x, _somewhere(rng, y0, y1)) for x in (_WALL + _END_DISTANCE, width - _WALL - _END_DISTANCE))
    south, north = ((_somewhere(rng, x0, x1), y) for y in (_WALL + _END_DISTANCE, height - _WALL - _END_DISTANCE))
    world = world_within(name, size, rng, west, _walls_around(size, areas), np.empty((0, 3)))
    return with_goals(world, [(west, east), (south, north), (east, west), (north, south)])


def _strip(rng: np.random.Generator, side: float) -> tuple[float, float]:
    width = min(float(rng.uniform(3.0, 4.5)), 0.5 * side)
    low = 0.5 * (side - width) + rng.uniform(-0.1, 0.1) * side
    return low, low + width


def _somewhere(rng: np.random.Generator, low: float, high: float) -> float:
    return float(rng.uniform(low + _END_DISTANCE, high - _END_DISTANCE))


def _walls_around(size: Size, areas: list[Area]) -> np.ndarray:
    width, height = map(units, size)
    solid = np.ones((height, width), dtype=bool)
    for area in areas:
        x0, y0, x1, y1 = map(units, area)
        solid[y0:y1, x0:x1] = False
    return outline(solid, UNIT * np.arange(width + 1), UNIT * np.arange(height + 1))


def _scatter(rng: np.random.Generator, area: Area, number: int, points: list[Point]) -> tuple[np.ndarray, np.ndarray]:
    taken = [(*point, 0.0) for point in points]
    segments, circles = [np.empty((0, 4))], []
    for _ in range(8 * number):
        is_box = rng.random() < 0.5
        length, depth = rng.uniform(0.4, 1.4, size=2) if is_box else rng.uniform(0.3, 0.8, size=1).repeat(2)
        radius = 0.5 * (math.hypot(length, depth) if is_box else length)
        low, high = np.array(area[:2]) + _GAP + radius, np.array(area[2:]) - _GAP - radius
        x, y = (low + rng.random(2) * (high - low)).tolist()
        angle = rng.uniform(0.0, math.pi)
        if (low > high).any() or any(math.hypot(x - a, y - b) < radius + r + _GAP for a, b, r in taken):
            continue
        taken.append((x, y, radius))
        if is_box:
            segments.append(edges(box(x, y, length, depth, angle)))
        else:
            circles.append((x, y, radius))
        if len(taken) == len(points) + number:
            break
    return np.vstack(segments), np.array(circles, dtype=np.float64).reshape(-1, 3)

import numpy as np

from ..world import World
from . import furniture
from .plan import INNER, WALL_CLEARANCE, FloorPlan, Item, Rect, Size, extent, shared_wall, touching_pairs, turn, units

_OUTER = 3
"""Thickness of outer walls [grid cells of 0.05 m]."""
_MIN_ROOM_SIDE, _MAX_ROOM_DEPTH = 38, 160
"""Minimum side and maximum depth of a room [grid cells of 0.05 m]."""
_SHAPES = {
    "L": (((1, 1, 4),), ((1, 1, 4),)),
    "T": (((2, 1, 4),), ((1, 0, 4),)),
    "U": (((1, 1, 4), (3, 1, 4)), ((1, 1, 3),)),
    "H": (((1, 0, 4), (3, 0, 4)), ((2, 1, 3),)),
    "O": (((1, 1, 3), (3, 1, 3)), ((1, 1, 3), (3, 1, 3))),
    "X": (((2, 0, 4),), ((2, 0, 4),)),
    "Z": (((2, 1, 3),), ((1, 0, 2), (3, 2, 4))),
}
"""Corridors of buildings by letter: vertical corridors, then horizontal corridors. Each corridor is (line, start line,
end line) on a grid of five lines per axis."""


def build(name: str, rng: np.random.Generator, size: Size) -> World:
    """Return a building in the shape of a letter, with rooms along corridors, of the given outer size [m]."""
    plan = FloorPlan(size, _OUTER, is_open=True)  # corridors overlap at junctions
    plan.solid[:] = True
    shape = str(rng.choice(list(_SHAPES)))
    corridors = _corridors(rng, plan.floor, shape)
    rooms, doors = _rooms(rng, plan, corridors)
    for x0, y0, x1, y1 in rooms + corridors:
        plan.solid[y0:y1, x0:x1] = False
    loops = rng.uniform(0.0, 0.35)
    doors += [(rooms[i], rooms[j]) for i, j, _ in touching_pairs(rooms) if rng.random() < loops]
    leaves = [_door(rng, plan, a, b) for a, b in doors]
    plan.settle()
    for leaf in filter(None, leaves):
        plan.put(*leaf)
    for room in rooms:
        _furnish(rng, plan, room)
    for corridor in corridors:
        for make in furniture.WALL_FURNITURE["corridor"][: int(rng.integers(4))]:
            plan.put_somewhere(rng, make(rng), corridor)
    return plan.build(name, rng, f"A building in the shape of the letter {shape}.")


def _corridors(rng: np.random.Generator, floor: Rect, shape: str) -> list[Rect]:
    x_lines, width = _lines(rng, floor[0], floor[2])
    y_lines, height = _lines(rng, floor[1], floor[3])
    upright, level = _SHAPES[shape][::-1] if rng.random() < 0.5 else _SHAPES[shape]
    corridors = [(x_lines[i], y_lines[a], x_lines[i] + width, y_lines[b] + height) for i, a, b in upright]
    corridors += [(x_lines[a], y_lines[i], x_lines[b] + width, y_lines[i] + height) for i, a, b in level]
    # Mirror the shape at random.
    if rng.random() < 0.5:
        corridors = [(floor[0] + floor[2] - c, b, floor[0] + floor[2] - a, d) for a, b, c, d in corridors]
    if rng.random() < 0.5:
        corridors = [(a, floor[1] + floor[3] - d, c, floor[1] + floor[3] - b) for a, b, c, d in corridors]
    if rng.random() < 0.7:
        x, y = (corridors[0][0] + corridors[0][2]) // 2, (corridors[-1][1] + corridors[-1][3]) // 2
        most = max(31, min(90, min(extent(floor, 0)) // 6))
        u, v = rng.integers(30, most, size=2).tolist()
        corridors.append((max(floor[0], x - u), max(floor[1], y - v), min(floor[2], x + u), min(floor[3], y + v)))
    return corridors


def _lines(rng: np.random.Generator, low: int, high: int) -> tuple[list[int], int]:
    length = high - low
    breadth = int(rng.integers(28, max(29, min(49, length // 5))))
    near, far = (length * rng.uniform(0.0, 0.28, size=2)).astype(int).tolist()
    # Strips too thin for rooms are dropped.
    near, far = (edge if edge >= _MIN_ROOM_SIDE + INNER else 0 for edge in (near, far))
    middle = low + int((length - breadth) * rng.uniform(0.38, 0.62))
    return [low, low + near, middle, high - breadth - far, high - breadth], breadth


def _rooms(
    rng: np.random.Generator, plan: FloorPlan, corridors: list[Rect]
) -> tuple[list[Rect], list[tuple[Rect, Rect]]]:
    x0, y0, x1, y1 = plan.floor
    taken = np.ones_like(plan.solid)
    taken[y0:y1, x0:x1] = False
    for x0, y0, x1, y1 in corridors:
        taken[y0 - INNER : y1 + INNER, x0 - INNER : x1 + INNER] = True
    most = min(_MAX_ROOM_DEPTH, int(0.4 * min(extent(plan.floor, 0))))
    doors: list[tuple[Rect, Rect]] = []
    for corridor in corridors:
        for side in rng.permutation(4).tolist():
            depth = int(rng.integers(min(60, most), most + 1))
            if taken.mean() < 0.5 or rng.random() < 0.8:
                doors += [(room, corridor) for room in _row(rng, taken, corridor, side, depth)]
    return [room for room, _ in doors], doors


def _row(rng: np.random.Generator, taken: np.ndarray, corridor: Rect, side: int, depth: int) -> list[Rect]:
    length = extent(corridor, side)[0]
    x0, y0, x1, y1 = turn((0, -INNER - depth, length, -INNER), corridor, side, 0)
    strip = taken[max(y0, 0) : y1, max(x0, 0) : x1]
    strip = (strip[::-1], strip.T, strip, strip.T[::-1])[side]
    reach = np.vstack([strip, np.ones((1, length), dtype=bool)]).argmax(axis=0)
    rooms: list[Rect] = []
    k = 0
    while k + _MIN_ROOM_SIDE <= length:
        short = np.flatnonzero(reach[k:] < _MIN_ROOM_SIDE)
        limit = int(short[0]) if len(short) else length - k
        if limit < _MIN_ROOM_SIDE:
            k += limit + 1
            continue
        spans = (_MIN_ROOM_SIDE, 56), (56, 100), (56, 100), (70, 120), (110, _MAX_ROOM_DEPTH)
        width = int(rng.integers(*spans[rng.integers(5)]))
        width = limit if limit - width < _MIN_ROOM_SIDE + INNER else width
        deep = int(reach[k : k + width].min())
        if rng.random() < 0.2:
            deep = max(_MIN_ROOM_SIDE, int(deep * rng.uniform(0.4, 1.0)))
        rooms.append(turn((k, -INNER - deep, k + width, -INNER), corridor, side, 0))
        k += width + INNER
    for x0, y0, x1, y1 in rooms:
        taken[y0 - INNER : y1 + INNER, x0 - INNER : x1 + INNER] = True
    return rooms


def _door(rng: np.random.Generator, plan: FloorPlan, room: Rect, other: Rect) -> tuple[Item, Rect, int, int] | None:
    wall = shared_wall(room, other)
    if wall is None:
        return None
    width = int(rng.integers(14, 21))
    start = plan.open_door(rng, room, other, wall, width)
    if rng.random() < 0.6:
        return None
    upright = wall[0]
    axis = 0 if upright else 1
    side = (3 if upright else 0) if other[axis] < room[axis] else (1 if upright else 2)
    leaf, at_right = furniture.door_leaf(rng, width)
    return leaf, room, side, (start + width if at_right else start - leaf.length) - room[1 - axis]


def _furnish(rng: np.random.Generator, plan: FloorPlan, room: Rect) -> None:
    pieces = furniture.WALL_FURNITURE[str(rng.choice(["living", "bedroom", "study", "office", "storage", "meeting"]))]
    area = (room[2] - room[0]) * (room[3] - room[1])
    most = min(len(pieces), round(area / units(2.2) ** 2))
    for make in pieces[: int(rng.integers(most + 1))]:
        plan.put_somewhere(rng, make(rng), room)
    if area > units(4.5) ** 2 and rng.random() < 0.4:
        make = furniture.table if rng.random() < 0.5 else furniture.cluster
        plan.put_somewhere(rng, make(rng), room, WALL_CLEARANCE)

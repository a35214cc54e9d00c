import math

import numpy as np

from ..world import World
from . import furniture
from .plan import INNER, ROBOT_HALF_SIDE, WALL_CLEARANCE, FloorPlan, Rect, Size, extent, mirror, touching_pairs, units

_OUTER = 3
"""Thickness of outer walls [grid cells of 0.05 m]."""
_MIN_ROOM_SIDE = 44
"""Minimum side of a room [grid cells of 0.05 m]."""


def build(name: str, rng: np.random.Generator, size: Size) -> World:
    """Return a furnished flat or office of the given outer size [m]."""
    plan = FloorPlan(size, _OUTER)
    is_office = min(size) >= 7.5 and rng.random() < 0.5
    rooms, corridors = _office(rng, plan.floor) if is_office else (_split(rng, plan.floor, units(3.4)), [])
    plan.solid[:] = True
    for x0, y0, x1, y1 in rooms + corridors:
        plan.solid[y0:y1, x0:x1] = False
    _open_doors(rng, plan, rooms, corridors)
    plan.settle()
    kinds = _kinds(rng, rooms, is_office)
    for room, kind in zip(rooms + corridors, kinds + ["corridor"] * len(corridors)):
        _furnish(rng, plan, room, kind)
    return plan.build(name, rng, "An office." if is_office else "A flat.")


def _split(rng: np.random.Generator, room: Rect, typical: int) -> list[Rect]:
    x0, y0, x1, y1 = room
    width, height = x1 - x0, y1 - y0
    across = width > height if abs(width - height) > 20 else rng.random() < 0.5
    longer = width if across else height
    slack = longer - INNER - 2 * _MIN_ROOM_SIDE
    large = width * height > (typical * (1.1 + rng.random())) ** 2 or longer > 2.6 * min(width, height)
    if slack < 0 or not large:
        return [room]
    cut = _MIN_ROOM_SIDE + int(slack * rng.beta(2, 2))
    if across:
        parts = (x0, y0, x0 + cut, y1), (x0 + cut + INNER, y0, x1, y1)
    else:
        parts = (x0, y0, x1, y0 + cut), (x0, y0 + cut + INNER, x1, y1)
    return [leaf for part in parts for leaf in _split(rng, part, typical)]


def _office(rng: np.random.Generator, floor: Rect) -> tuple[list[Rect], list[Rect]]:
    x0, y0, x1, y1 = floor
    if x1 - x0 < y1 - y0:
        rooms, corridors = _office(rng, (y0, x0, y1, x1))
        return [mirror(room) for room in rooms], [mirror(corridor) for corridor in corridors]
    breadth = int(rng.integers(28, 37))
    depth = (y1 - y0 - breadth) // 2 - INNER
    shift = int(rng.integers(-depth // 5, depth // 5 + 1)) if depth > 1.25 * _MIN_ROOM_SIDE else 0
    low = y0 + depth + INNER + shift
    corridor = (x0, low, x1, low + breadth)
    rooms, corridors = [], [corridor]
    for side in ((x0, y0, x1, low - INNER), (x0, low + breadth + INNER, x1, y1)):
        if side[3] - side[1] > units(9.0):
            inner_rooms, inner_corridors = _office(rng, side)
            rooms += inner_rooms
            corridors += inner_corridors
        else:
            rooms += _row(rng, side)
    return rooms, corridors


def _row(rng: np.random.Generator, strip: Rect) -> list[Rect]:
    x0, y0, x1, y1 = strip
    rooms = []
    while x1 - x0 > 2 * _MIN_ROOM_SIDE + 30:
        width = min(int(rng.integers(_MIN_ROOM_SIDE + 8, 110)), x1 - x0 - _MIN_ROOM_SIDE - INNER)
        rooms.append((x0, y0, x0 + width, y1))
        x0 += width + INNER
    return [*rooms, (x0, y0, x1, y1)]


def _open_doors(rng: np.random.Generator, plan: FloorPlan, rooms: list[Rect], corridors: list[Rect]) -> None:
    every = rooms + corridors
    # Prefer doors to corridors.
    pairs = [(float(rng.random()) - (j >= len(rooms)), i, j, wall) for i, j, wall in touching_pairs(every)]
    group = list(range(len(every)))
    for _, i, j, wall in sorted(pairs):
        if group[i] != group[j]:
            group = [group[i] if g == group[j] else g for g in group]
        elif rng.random() > (0.06 if corridors else 0.3):
            continue  # already connected
        wide = not corridors and wall[2] - wall[1] > 60 and rng.random() < 0.2
        width = int(rng.integers(30, 45)) if wide else int(rng.integers(18, 22))
        plan.open_door(rng, every[i], every[j], wall, width)


def _kinds(rng: np.random.Generator, rooms: list[Rect], is_office: bool) -> list[str]:
    order = sorted(range(len(rooms)), key=lambda i: math.prod(extent(rooms[i], 0)))
    if is_office:
        kinds = ["office"] * len(rooms)
        kinds[order[0]] = "storage"
        if len(rooms) > 2:
            kinds[order[-1]] = "meeting"
        if len(rooms) > 4:
            kinds[order[1]] = "kitchen"
    else:
        kinds = [str(rng.choice(["bedroom", "bedroom", "study"])) for _ in rooms]
        kinds[order[0]] = "bath"
        kinds[order[-1]] = "living"
        if len(rooms) > 2:
            kinds[order[len(rooms) // 2]] = "kitchen"
    return kinds


def _furnish(rng: np.random.Generator, plan: FloorPlan, room: Rect, kind: str) -> None:
    area, longer = math.prod(extent(room, 0)), max(extent(room, 0))
    if kind == "kitchen":
        length = min(int(rng.integers(44, 80)), longer - 2 * ROBOT_HALF_SIDE)
        plan.put_somewhere(rng, furniture.counter(rng, length), room, attempts=8)
    elif kind == "meeting":
        length = min(int(rng.integers(40, 90)), longer - 40)
        if length >= 32:
            plan.put_somewhere(rng, furniture.conference(rng, length), room, WALL_CLEARANCE, attempts=8)
    elif kind == "office" and area > units(4.6) ** 2:
        for _ in range(area // units(4.4) ** 2):
            plan.put_somewhere(rng, furniture.cluster(rng), room, WALL_CLEARANCE)
    if kind in ("kitchen", "living") and area > units(3.6) ** 2:
        plan.put_somewhere(rng, furniture.table(rng), room, WALL_CLEARANCE)
    pieces = furniture.WALL_FURNITURE[kind]
    count = max(1, min(len(pieces), round(area / units(1.6) ** 2)))
    for make in pieces[:count]:
        if rng.random() < 0.85:
            plan.put_somewhere(rng, make(rng), room)

import numpy as np

from ..world import World
from . import furniture
from .plan import WALL_CLEARANCE, FloorPlan, Item, Rect, Size, extent, mirror, units

_WALL = 4
"""Thickness of the outer walls [grid cells of 0.05 m]."""


def build(name: str, rng: np.random.Generator, size: Size) -> World:
    """Return a warehouse of the given outer size [m], with aisles about 1.6 to 4 m wide."""
    plan = FloorPlan(size, _WALL, is_open=True)
    plan.settle()
    loading, storage = _divide(rng, plan.floor)
    if min(size) >= 11 and rng.random() < 0.6:
        _put_office(rng, plan, loading)
    _put_racks(rng, plan, storage)
    _put_columns(rng, plan)
    _put_goods(rng, plan, loading)
    return plan.build(name, rng)


def _divide(rng: np.random.Generator, floor: Rect) -> tuple[Rect, Rect]:
    x0, y0, x1, y1 = floor
    if x1 - x0 < y1 - y0:
        loading, storage = _divide(rng, mirror(floor))
        return mirror(loading), mirror(storage)
    cut = int((x1 - x0) * rng.uniform(0.18, 0.32))
    first = rng.random() < 0.5
    line = x0 + cut if first else x1 - cut
    near, far = (x0, y0, line, y1), (line, y0, x1, y1)
    return (near, far) if first else (far, near)


def _put_racks(rng: np.random.Generator, plan: FloorPlan, zone: Rect) -> None:
    side = 0 if rng.random() < 0.65 else 3  # wall parallel to the rows
    length, depth = extent(zone, side)
    bay, cross = int(rng.integers(46, 57)), int(rng.integers(34, 50))
    blocks = max(1, round(length / units(rng.uniform(8.0, 14.0))))
    bays = (length - (blocks + 1) * cross) // (blocks * bay)
    cross = (length - blocks * bays * bay) // (blocks + 1)
    empty = rng.uniform(0.0, 0.12)
    for away, thickness in _rows(rng, depth):
        for block in range(blocks):
            for first, last in _stretches(rng, bays, empty):
                item = Item((last - first) * bay, thickness, rects=((0, 0, (last - first) * bay, thickness),))
                plan.put(item, zone, side, cross + block * (cross + bays * bay) + first * bay, away)


def _rows(rng: np.random.Generator, depth: int) -> list[tuple[int, int]]:
    rack, aisle = int(rng.integers(16, 23)), int(rng.integers(36, 58))
    along_walls = rng.random(2) < 0.6
    ends = rack * int(along_walls.sum())
    # Leftover space widens the aisles.
    doubles = max(0, round((depth - ends - aisle) / (2 * rack + aisle) - 0.2))
    aisle = (depth - ends - 2 * rack * doubles) // (doubles + 1)
    rows = [(0, rack)] if along_walls[0] else []
    away = (rack if along_walls[0] else 0) + aisle
    for _ in range(doubles):
        rows.append((away, 2 * rack))
        away += 2 * rack + aisle
    if along_walls[1] and depth >= 2 * rack + aisle:
        rows.append((depth - rack, rack))
    return rows


def _stretches(rng: np.random.Generator, count: int, empty: float) -> list[tuple[int, int]]:
    present = [bool(rng.random() >= empty) for _ in range(count)]
    edges = [k for k in range(count + 1) if (k > 0 and present[k - 1]) != (k < count and present[k])]
    return list(zip(edges[::2], edges[1::2]))


def _put_office(rng: np.random.Generator, plan: FloorPlan, zone: Rect) -> None:
    width, depth = int(rng.integers(56, 80)), int(rng.integers(50, 66))
    door = int(rng.integers(6, width - 28))
    wall = ((0, depth - 2, door, depth), (door + 20, depth - 2, width, depth))
    item = Item(width, depth, rects=(*wall, (0, 0, 2, depth - 2), (width - 2, 0, width, depth - 2)))
    side = int(rng.integers(4))
    slack = extent(zone, side)[0] - width
    if slack >= 0:
        plan.put(item, zone, side, int(rng.choice([0, slack])))


def _put_columns(rng: np.random.Generator, plan: FloorPlan) -> None:
    if rng.random() < 0.3:
        return
    x0, y0, x1, y1 = plan.floor
    step_x, step_y = (round((b - a) / max(2, round((b - a) / units(6.0)))) for a, b in ((x0, x1), (y0, y1)))
    column = furniture.block(0.4, 0.4)
    for x in range(x0 + step_x, x1 - 20, step_x):
        for y in range(y0 + step_y, y1 - 20, step_y):
            plan.put(column, plan.floor, 0, x - 4 - x0, y - 4 - y0)


def _put_goods(rng: np.random.Generator, plan: FloorPlan, loading: Rect) -> None:
    side = int(rng.integers(4))
    length, depth = extent(loading, side)
    gap, step = int(rng.integers(24, 40)), 16 + int(rng.integers(1, 5))
    most = min(6, (depth - 60) // step)
    for along in range(gap, length - 24 - gap, 24 + gap):
        count = int(rng.integers(most + 1)) if most > 0 else 0
        if count:
            pallets = Item(24, step * count, rects=tuple((0, step * k, 24, step * k + 16) for k in range(count)))
            plan.put(pallets, loading, side, along, int(rng.integers(20, 30)))
    for _ in range(3):
        plan.put_somewhere(rng, furniture.rack(rng), loading)
    for make in (furniture.chest, furniture.plant, furniture.chest):
        plan.put_somewhere(rng, make(rng), plan.floor, WALL_CLEARANCE)
    for _ in range(int(rng.integers(1, 4))):
        plan.put_somewhere(rng, furniture.block(1.2, 0.8), loading, WALL_CLEARANCE)

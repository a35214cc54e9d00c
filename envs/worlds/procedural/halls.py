import math
from itertools import pairwise, product

import numpy as np

from ..world import World
from . import furniture
from .plan import FloorPlan, Item, Rect, Size, extent, mirror, units


def build(name: str, rng: np.random.Generator, size: Size) -> World:
    """Return one to three open halls with columns, screens or boxes, of the given outer size [m]."""
    plan = FloorPlan(size, int(rng.integers(2, 6)), is_open=True)
    halls = _divide(rng, plan)
    if rng.random() < 0.35:
        _cut_corners(rng, plan, halls)
    plan.settle()
    styles = [_put_columns, _put_screens, _put_machines, _put_benches, _put_boxes, _put_niches, _put_core]
    common = int(rng.integers(len(styles) - 1))  # excludes the core
    for hall in halls:
        for k in [common, *rng.integers(len(styles), size=int(rng.integers(4)))]:
            styles[k](rng, plan, hall)
    return plan.build(name, rng)


def _divide(rng: np.random.Generator, plan: FloorPlan) -> list[Rect]:
    upright = plan.width < plan.height
    solid = plan.solid.T if upright else plan.solid
    x0, y0, x1, y1 = mirror(plan.floor) if upright else plan.floor
    most = 1 if x1 - x0 < units(9.0) else 2 if x1 - x0 < units(14.0) else 3
    count = 1 if rng.random() < 0.3 else int(rng.integers(1, most + 1))
    wall = int(rng.integers(2, 6))
    shares = np.cumsum(rng.uniform(1.0, 2.0, size=count))
    cuts = [x0 - wall, *(x0 + (shares[:-1] / shares[-1] * (x1 - x0)).astype(int)).tolist(), x1]
    halls: list[Rect] = []
    solid[:] = True
    for low, high in pairwise(cuts):
        back = [int(rng.uniform(0.0, 0.3) * (y1 - y0)) if count > 1 and rng.random() < 0.3 else 0 for _ in range(2)]
        hall = (low + wall, y0 + back[0], high, y1 - back[1])
        solid[hall[1] : hall[3], hall[0] : hall[2]] = False
        if halls:
            bottom, top = max(hall[1], halls[-1][1]), min(hall[3], halls[-1][3])
            for _ in range(int(rng.integers(1, 3))):
                width = int(rng.integers(24, max(25, (top - bottom) // 2 + 1)))
                start = int(rng.integers(bottom, top - width + 1))
                solid[start : start + width, low : low + wall] = False
        halls.append(hall)
    return [mirror(hall) for hall in halls] if upright else halls


def _cut_corners(rng: np.random.Generator, plan: FloorPlan, halls: list[Rect]) -> None:
    x0, y0, x1, y1 = plan.floor
    u, v = (min(min(extent(hall, 0)) for hall in halls) * rng.uniform(0.1, 0.35, size=2)).tolist()
    rows, cols = np.ogrid[0.5 : plan.height, 0.5 : plan.width]
    each = rng.random() < 0.6
    for x, y in product((cols - x0, x1 - cols), (rows - y0, y1 - rows)):
        if each or rng.random() < 0.5:
            plan.solid |= x / u + y / v < 1.0


def _angle(rng: np.random.Generator, slanted: float) -> float:
    return float(rng.uniform(0.0, math.pi)) if rng.random() < slanted else 0.5 * math.pi * int(rng.integers(4))


def _scatter(rng: np.random.Generator, plan: FloorPlan, hall: Rect, items: list[Item]) -> None:
    for item in items:
        plan.put_somewhere(rng, item, hall, 0 if rng.random() < 0.15 else 8)


def _count(rng: np.random.Generator, hall: Rect, low: float, high: float) -> int:
    return min(20, max(1, round(math.prod(extent(hall, 0)) / units(rng.uniform(low, high)) ** 2)))


def _grid(rng: np.random.Generator, plan: FloorPlan, hall: Rect, item: Item, gaps: tuple[int, int]) -> None:
    side = int(rng.integers(2))
    starts = []
    for span, length in zip(extent(hall, side), (item.length, item.depth)):
        pitch = length + int(rng.integers(gaps[0], max(gaps[1], span // 4)))
        number = min((span - gaps[0]) // pitch, int(rng.integers(2, 8)))
        first = (span - (number - 1) * pitch - length) // 2
        starts.append([first + k * pitch for k in range(number)])
    lack = rng.choice([0.0, 0.0, 0.25])
    for along, gap in product(*starts):
        if rng.random() >= lack:
            plan.put(item, hall, side, along, gap)


def _put_columns(rng: np.random.Generator, plan: FloorPlan, hall: Rect) -> None:
    radius = float(rng.uniform(2.0, 7.0))
    item = furniture.disc(radius) if rng.random() < 0.6 else furniture.bars([(0, 0, 2 * radius, 0)], 2 * radius, 0.0)
    if rng.random() < 0.7:
        _grid(rng, plan, hall, item, (20, 70))
    else:
        _scatter(rng, plan, hall, [item] * _count(rng, hall, 1.8, 4.0))


def _put_screens(rng: np.random.Generator, plan: FloorPlan, hall: Rect) -> None:
    slanted, thickness = rng.choice([0.0, 0.0, 0.3, 0.7]), int(rng.integers(2, 5))
    longest = min(70.0, max(25.0, 0.45 * min(extent(hall, 0))))
    items = []
    for u, v in rng.uniform(16.0, longest, size=(_count(rng, hall, 2.5, 5.0), 2)).tolist():
        shape: list[furniture.Bar] = [(0, 0, u, 0)]
        shape += [[], [(0, 0, 0, v)], [(u / 2, 0, u / 2, v)], [(u / 2, -v / 2, u / 2, v / 2)]][int(rng.integers(4))]
        items.append(furniture.bars(shape, thickness, _angle(rng, slanted)))
    _scatter(rng, plan, hall, items)


def _put_machines(rng: np.random.Generator, plan: FloorPlan, hall: Rect) -> None:
    sizes = rng.uniform([12.0, 10.0], [50.0, 30.0], size=(_count(rng, hall, 2.5, 5.0), 2)).tolist()
    _scatter(rng, plan, hall, [furniture.bars([(0, 0, u, 0)], v, _angle(rng, 0.3)) for u, v in sizes])


def _put_benches(rng: np.random.Generator, plan: FloorPlan, hall: Rect) -> None:
    _grid(rng, plan, hall, furniture.block(rng.uniform(1.0, 2.6), rng.uniform(0.4, 0.9)), (20, 45))


def _put_boxes(rng: np.random.Generator, plan: FloorPlan, hall: Rect) -> None:
    for _ in range(_count(rng, hall, 3.5, 7.0)):
        x, y = (int(rng.integers(span)) for span in extent(hall, 0))
        for _ in range(int(rng.integers(2, 8))):
            u, v = rng.integers(-24, 25, size=2).tolist()
            plan.put(furniture.block(*rng.uniform(0.3, 0.8, size=2).tolist()), hall, 0, x + u, y + v)


def _put_niches(rng: np.random.Generator, plan: FloorPlan, hall: Rect) -> None:
    thickness, depth, pitch = (int(rng.integers(*span)) for span in ((2, 16), (10, 36), (40, 90)))
    item = Item(thickness, depth, ((0, 0, thickness, depth),))
    for side in rng.permutation(4)[: int(rng.integers(1, 4))].tolist():
        for along in range(pitch // 2, extent(hall, side)[0] - thickness, pitch + thickness):
            plan.put(item, hall, side, along)


def _put_core(rng: np.random.Generator, plan: FloorPlan, hall: Rect) -> None:
    width, height = extent(hall, 0)
    u, v = (int(min(span * rng.uniform(0.2, 0.6), span - 48)) for span in (width, height))
    if min(u, v) > 8:
        x, y = (int((span - length) * rng.uniform(0.35, 0.65)) for span, length in ((width, u), (height, v)))
        plan.put(Item(u, v, ((0, 0, u, v),)), hall, 0, x, y)

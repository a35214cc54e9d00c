"""Furniture of floor plans, as a horizontal section 0.2 m above the floor."""

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from .plan import Disc, Item, Rect, units

_LEG = 0.5
"""Radius of a table leg or chair leg [grid cells of 0.05 m]."""

Bar = tuple[float, float, float, float]
"""Line between two points as (x0, y0, x1, y1) [grid cells of 0.05 m]."""


def block(length: float, depth: float) -> Item:
    """Return a solid box of the given size [m]."""
    u, v = units(length), units(depth)
    return Item(u, v, rects=((0, 0, u, v),))


def disc(radius: float) -> Item:
    """Return a round column of `radius` [grid cells of 0.05 m]."""
    side = math.ceil(2 * radius)
    return Item(side, side, discs=((side / 2, side / 2, radius),))


def bars(lines: list[Bar], thickness: float, angle: float) -> Item:
    """Return an obstacle of straight bars, rotated by `angle` [rad]; `lines`, `thickness`: in grid cells of 0.05 m."""
    ends = np.array(lines, dtype=np.float64).reshape(-1, 2, 2)
    ends = ends @ [[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]]
    low = ends.min(axis=(0, 1)) - thickness
    width, height = np.ceil(ends.max(axis=(0, 1)) + thickness - low).astype(int).tolist()
    points = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1) + 0.5 + low
    mask = np.zeros((height, width), dtype=bool)
    for start, end in ends:
        length = math.hypot(*(end - start))
        x, y = ((end - start) / length).tolist()
        along, across = (points - start) @ [x, y], (points - start) @ [-y, x]
        mask |= (along > 0) & (along < length) & (np.abs(across) < thickness / 2)
    rows, cols = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    mask = mask[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
    rects: list[Rect] = []
    for y, row in enumerate(np.pad(mask, ((0, 0), (1, 1)))):
        changes = np.flatnonzero(row[1:] != row[:-1]).tolist()
        rects += [(a, y, b, y + 1) for a, b in zip(changes[::2], changes[1::2])]
    return Item(mask.shape[1], mask.shape[0], tuple(rects))


def door_leaf(rng: np.random.Generator, width: int) -> tuple[Item, bool]:
    """Return a door leaf, open by 90 to 135 degrees, and True if its hinge is at the right.

    `width`: of the door [grid cells of 0.05 m].
    """
    angle = float(rng.uniform(0.0, 0.25 * math.pi))
    points = np.arange(width)[:, None] * [math.sin(angle), math.cos(angle)]
    xs, ys = np.unique(points.astype(int), axis=0).T.tolist()
    length = max(xs) + 1
    at_right = bool(rng.random() < 0.5)
    xs = xs if at_right else [length - 1 - x for x in xs]
    return Item(length, max(ys) + 1, rects=tuple((x, y, x + 1, y + 1) for x, y in zip(xs, ys))), at_right


def _random_block(length: tuple[float, float], depth: float | tuple[float, float], rng: np.random.Generator) -> Item:
    return block(float(rng.uniform(*length)), float(rng.uniform(*depth)) if isinstance(depth, tuple) else depth)


cupboard = partial(_random_block, (0.8, 2.0), (0.4, 0.6))
shelf = partial(_random_block, (0.6, 1.8), 0.3)
chest = partial(_random_block, (0.5, 0.9), (0.4, 0.6))
basin = partial(_random_block, (0.5, 0.9), 0.45)
rack = partial(_random_block, (1.2, 2.6), 0.5)


def _legs(x0: float, y0: float, x1: float, y1: float) -> tuple[Disc, ...]:
    return tuple((x, y, _LEG) for x in (x0 + _LEG, x1 - _LEG) for y in (y0 + _LEG, y1 - _LEG))


def sofa(rng: np.random.Generator) -> Item:
    """Return a sofa, 1.6 to 2.25 m long."""
    length = int(rng.integers(32, 46))
    rects = [(0, 0, length, 18)]
    if rng.random() < 0.6:
        rects.append((length // 2 - 10, 27, length // 2 + 10, 37))
    return Item(length, rects[-1][3], rects=tuple(rects))


def bed(rng: np.random.Generator) -> Item:
    """Return a bed, 0.9 to 1.8 m wide, with night stands."""
    width = int(rng.choice([18, 28, 32, 36]))
    rects: list[Rect] = [(9, 0, 9 + width, 41), (0, 0, 8, 8)]
    if width > 18:
        rects.append((width + 10, 0, width + 18, 8))
    return Item(max(rect[2] for rect in rects), 41, rects=tuple(rects))


def desk(rng: np.random.Generator) -> Item:
    """Return a desk, 1.3 to 1.65 m long, with an office chair."""
    length = int(rng.integers(26, 34))
    rects = ((0, 0, 1, 15), (length - 8, 1, length, 15))
    return Item(length, 21, rects=rects, discs=((length / 2 - 4 + rng.random() * 3, 16.0, 5.0),))


def table(rng: np.random.Generator) -> Item:
    """Return a table with chairs, all on four legs."""
    length, depth = int(rng.integers(22, 40)), int(rng.integers(14, 20))
    legs = list(_legs(1, 6, length - 1, 6 + depth))
    per_side = length // 13
    for k in range(per_side):
        x = (k + 0.5) * length / per_side - 4
        for y in (0.0, depth + 4.0):
            if rng.random() < 0.85:
                pushed = rng.random() * 2
                legs += _legs(x, y + pushed, x + 8, y + pushed + 6)
    return Item(length, depth + 12, discs=tuple(legs))


def conference(rng: np.random.Generator, length: int) -> Item:
    """Return a conference table of `length` [grid cells of 0.05 m] with office chairs."""
    depth = int(rng.integers(20, 25))
    stand = (7, 10 + depth // 2 - 3, length - 7, 10 + depth // 2 + 3)
    seats = length // 15
    seats_at = [((k + 0.5) * length / seats, y) for k in range(seats) for y in (6.0, depth + 14.0)]
    chairs = tuple((x, y, 5.0) for x, y in seats_at if rng.random() < 0.9)
    return Item(length, depth + 20, rects=(stand,), discs=chairs)


def counter(rng: np.random.Generator, length: int) -> Item:
    """Return a kitchen counter of `length` [grid cells of 0.05 m] with a fridge."""
    return Item(length, 14, rects=((0, 0, length - 14, 12), (length - 13, 0, length, 14)))


def cluster(rng: np.random.Generator) -> Item:
    """Return four desks with chairs around a screen."""
    length = int(rng.integers(26, 33))
    screen = (0, 25, 2 * length, 27)
    panels = tuple((x, 11, x + 1, 41) for x in (0, length - 1, 2 * length - 1))
    seats = [(x, y) for x in (length / 2, 1.5 * length) for y in (8.0, 44.0)]
    chairs = tuple((x + rng.random() * 2 - 1, y, 5.0) for x, y in seats)
    return Item(2 * length, 52, rects=(screen, *panels), discs=chairs)


def plant(rng: np.random.Generator) -> Item:
    """Return a plant pot or a waste bin."""
    side = units(2 * float(rng.choice([0.1, 0.15, 0.2])))
    return Item(side, side, discs=((side / 2, side / 2, side / 2),))


def bath(rng: np.random.Generator) -> Item:
    """Return a bath tub or a shower."""
    return block(1.65, 0.75) if rng.random() < 0.6 else block(0.9, 0.9)


def toilet(rng: np.random.Generator) -> Item:
    """Return a toilet, 0.4 m wide and 0.65 m deep."""
    return Item(8, 13, rects=((0, 0, 8, 4), (1, 4, 7, 13)))


WALL_FURNITURE: dict[str, tuple[Callable[[np.random.Generator], Item], ...]] = {
    "living": (sofa, shelf, chest, cupboard, plant, sofa, shelf),
    "bedroom": (bed, cupboard, desk, chest, plant),
    "kitchen": (chest, shelf, plant),
    "bath": (bath, toilet, basin, chest),
    "corridor": (shelf, plant, chest),
    "study": (desk, shelf, shelf, cupboard, plant),
    "office": (desk, desk, shelf, cupboard, plant, desk),
    "meeting": (shelf, plant, chest),
    "storage": (rack, rack, rack, chest, rack),
}
"""Furniture along walls by kind of room, in order of placement."""

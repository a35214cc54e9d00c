"""A floor plan in whole units, into which bodies are put so that a robot still gets everywhere."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import ndimage

from lidarnaut.envs.geometry import Pose2D

from ..raster import outline
from ..world import World, box, edges

UNIT = 0.05
"""Side of a unit square of a plan [m]."""
REACH = 6
"""Half the side of the square that gets everywhere in a plan [units]: more than a robot of 0.25 m radius needs."""
MARGIN = 14
"""How far from the walls of a room stands what is put into its middle [units]."""
INNER = 2
"""Thickness of inner walls [units]."""
_DOOR_ROOM = 16
"""How far before a door the floor stays empty [units]."""

Size = tuple[float, float]
"""Width and height [m]."""
Point = tuple[float, float]
"""Position (x, y) [m]."""
Rect = tuple[int, int, int, int]
"""Half-open rectangle of unit squares (x0, y0, x1, y1)."""
Disc = tuple[float, float, float]
"""Centre and radius (x, y, radius) [units]."""
Wall = tuple[bool, int, int]
"""Whether a wall is upright, and from where to where along it two rooms touch [units]."""


def units(metres: float) -> int:
    """Return a length in whole units, rounded."""
    return round(metres / UNIT)


def mirror(rect: Rect) -> Rect:
    """Return a rectangle with x and y exchanged."""
    return rect[1], rect[0], rect[3], rect[2]


def extent(room: Rect, side: int) -> tuple[int, int]:
    """Return how far a room reaches along a wall and away from it: 0 south, 1 east, 2 north, 3 west."""
    width, height = room[2] - room[0], room[3] - room[1]
    return (width, height) if side % 2 == 0 else (height, width)


def is_one_piece(blocked: np.ndarray) -> bool:
    """Tell whether the cells that are not blocked (shape (height, width), bool) hang together, and there are any."""
    return bool(ndimage.label(~blocked)[1] == 1)


@dataclass(frozen=True, slots=True)
class Item:
    """Something to put somewhere, seen with its back to the wall: x along the wall, y away from it [units]."""

    length: int
    """Extent along the wall."""
    depth: int
    """Extent away from the wall."""
    rects: tuple[Rect, ...] = ()
    """Solid rectangles."""
    discs: tuple[Disc, ...] = ()
    """Solid discs."""


class Plan:
    """A floor plan: walls first, then doors, then `settle`, then bodies."""

    def __init__(self, size: Size, wall: int, is_open: bool = False) -> None:
        """Start with walls [units] around a floor of an outer size [m]; if it is open, there are none between rooms."""
        self.width, self.height = units(size[0]), units(size[1])
        self.floor: Rect = (wall, wall, self.width - wall, self.height - wall)
        self._is_open = is_open
        self.solid = np.ones((self.height, self.width), dtype=bool)
        self.solid[wall:-wall, wall:-wall] = False
        self.blocked = np.empty_like(self.solid)
        """Where the centre of a square of side 2 `REACH` cannot be."""
        self.reserved = np.zeros_like(self.solid)
        """Where nothing may be put, such as before doors."""
        self.discs: list[Disc] = []

    def open_door(self, rng: np.random.Generator, a: Rect, b: Rect, wall: Wall, width: int) -> int:
        """Cut a door into a wall between rooms, and keep the floor before it empty; return where along it it begins."""
        upright, low, high = wall
        # Most doors are near a corner, as in real houses.
        slack = high - low - width - 6
        start = low + 3 + (int(rng.choice([0, slack])) if rng.random() < 0.5 else int(rng.integers(slack + 1)))
        p, q = (a, b) if upright else (mirror(a), mirror(b))
        left = min(p[2], q[2])
        solid, reserved = (self.solid, self.reserved) if upright else (self.solid.T, self.reserved.T)
        solid[start : start + width, left : left + INNER] = False
        reserved[start : start + width, left - _DOOR_ROOM : left + INNER + _DOOR_ROOM] = True
        return start

    def settle(self) -> None:
        """Work out where a robot can be among the walls; call it once they are complete."""
        self.blocked = ndimage.maximum_filter(self.solid, 2 * REACH + 1, mode="constant", cval=True)

    def put(self, item: Item, room: Rect, side: int, along: int, gap: int = 0) -> bool:
        """Put an item into a room, if it fits and the rest of the room, or of an open floor, stays in one piece.

        It turns its back to the wall `side` (0 south, 1 east, 2 north, 3 west), `gap` away from it and `along` from the
        room's lower or left corner. Returns whether it was put.
        """
        x0, y0, x1, y1 = turn((0, gap, item.length, gap + item.depth), room, side, along)
        if x0 < room[0] or y0 < room[1] or x1 > room[2] or y1 > room[3]:
            return False
        if self.solid[y0:y1, x0:x1].any() or self.reserved[y0:y1, x0:x1].any():
            return False
        rects = [turn((a, b + gap, c, d + gap), room, side, along) for a, b, c, d in item.rects]
        turned = [turn((x, y + gap, x, y + gap), room, side, along) for x, y, _ in item.discs]
        discs = [(x, y, radius) for (x, y, _, _), (_, _, radius) in zip(turned, item.discs)]
        grown = [(a - REACH, b - REACH, c + REACH, d + REACH) for a, b, c, d in rects]
        for x, y, radius in discs:
            far = radius + REACH
            grown.append((math.floor(x - far), math.floor(y - far), math.ceil(x + far), math.ceil(y + far)))
        low_x, low_y, high_x, high_y = zip(*grown)
        around = self.blocked[max(min(low_y) - 1, 0) : max(high_y) + 1, max(min(low_x) - 1, 0) : max(high_x) + 1]
        before = around.copy()
        for a, b, c, d in grown:
            self.blocked[max(b, 0) : d, max(a, 0) : c] = True
        # If the surroundings hang together without a detour, so does all else; only otherwise the whole is looked at.
        x0_whole, y0_whole, x1_whole, y1_whole = self.floor if self._is_open else room
        if not is_one_piece(around) and not is_one_piece(self.blocked[y0_whole:y1_whole, x0_whole:x1_whole]):
            around[:] = before
            return False
        for a, b, c, d in rects:
            self.solid[b:d, a:c] = True
        self.reserved[y0:y1, x0:x1] = True
        self.discs += discs
        return True

    def put_somewhere(
        self, rng: np.random.Generator, item: Item, room: Rect, margin: int = 0, attempts: int = 4
    ) -> None:
        """Put an item into a room, trying a few positions: away from its walls by `margin`, or else its back to one."""
        for _ in range(attempts):
            side = int(rng.integers(4))
            length, depth = extent(room, side)
            slack_along = length - item.length - 2 * margin
            slack_away = depth - item.depth - 2 * margin if margin else 0
            if slack_along >= 0 and slack_away >= 0:
                along = margin + int(rng.integers(slack_along + 1))
                gap = margin + int(rng.integers(slack_away + 1)) if margin else 0
                if self.put(item, room, side, along, gap):
                    return

    def build(self, name: str, rng: np.random.Generator, notes: str = "") -> World:
        """Return the plan as a world with its lower left corner at the origin, and a spawn drawn where a robot fits."""
        xs, ys = UNIT * np.arange(self.width + 1), UNIT * np.arange(self.height + 1)
        cells = np.flatnonzero(~self.blocked)
        row, col = divmod(int(cells[rng.integers(len(cells))]), self.width)
        spawn = UNIT * (col + 0.5), UNIT * (row + 0.5)
        segments, circles = outline(self.solid, xs, ys), np.array(self.discs, dtype=np.float64).reshape(-1, 3) * UNIT
        return world_within(name, (xs[-1], ys[-1]), rng, spawn, segments, circles, notes)


def world_within(
    name: str,
    size: Size,
    rng: np.random.Generator,
    spawn: tuple[float, float],
    segments: np.ndarray,
    circles: np.ndarray,
    notes: str = "",
) -> World:
    """Return a generated world with a rectangle of the given size around it; the heading of its spawn is drawn."""
    x, y = map(float, spawn)
    width, height = map(float, size)
    around = edges(box(0.5 * width, 0.5 * height, width, height))
    return World(
        name=name,
        segments=np.vstack([around, segments]),
        circles=circles,
        spawns=(Pose2D(x, y, float(rng.uniform(-math.pi, math.pi))),),
        bounds=(0.0, 0.0, width, height),
        source="generated",
        licence="MIT",
        notes=notes,
    )


def with_goals(world: World, trips: Sequence[tuple[Point, Point]]) -> World:
    """Return a world whose spawns are at the first points of trips, headed for the second ones, which are the goals."""
    headings = [math.atan2(goal[1] - start[1], goal[0] - start[0]) for start, goal in trips]
    spawns = tuple(Pose2D(*start, theta) for (start, _), theta in zip(trips, headings))
    return replace(world, spawns=spawns, goals=tuple(Pose2D(*goal, theta) for (_, goal), theta in zip(trips, headings)))


def turn(rect: Any, room: Rect, side: int, along: int) -> Any:
    """Carry a rectangle from an item's frame, back to a wall of a room, into the plan."""
    a, b, c, d = rect
    x0, y0, x1, y1 = room
    return (
        (x0 + along + a, y0 + b, x0 + along + c, y0 + d),
        (x1 - d, y0 + along + a, x1 - b, y0 + along + c),
        (x0 + along + a, y1 - d, x0 + along + c, y1 - b),
        (x0 + b, y0 + along + a, x0 + d, y0 + along + c),
    )[side]


def shared_wall(a: Rect, b: Rect) -> Wall | None:
    """Return how two rooms touch: whether through an upright wall, and from where to where; None if they do not."""
    for upright in (True, False):
        p, q = (a, b) if upright else (mirror(a), mirror(b))
        if p[2] + INNER == q[0] or q[2] + INNER == p[0]:
            low, high = max(p[1], q[1]), min(p[3], q[3])
            if high - low >= 28:
                return upright, low, high
    return None


def touching_pairs(rooms: list[Rect]) -> list[tuple[int, int, Wall]]:
    """Return the pairs of rooms (i < j) with enough of a wall between them for a door, and that wall."""
    x0, y0, x1, y1 = np.array(rooms, dtype=int).reshape(-1, 4).T
    touching = (x1[:, None] + INNER == x0) | (y1[:, None] + INNER == y0)
    pairs = np.argwhere(np.tril(touching | touching.T, -1)).tolist()
    return [(i, j, wall) for j, i in pairs if (wall := shared_wall(rooms[i], rooms[j]))]

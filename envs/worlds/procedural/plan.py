"""Furnished floor plans with connected free space."""

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
"""Side of a grid cell of floor plans [m]."""
ROBOT_HALF_SIDE = 6
"""Half the side of the square robot footprint that fits everywhere [grid cells of 0.05 m]."""
WALL_CLEARANCE = 14
"""Distance between walls and free-standing furniture [grid cells of 0.05 m]."""
INNER = 2
"""Thickness of inner walls [grid cells of 0.05 m]."""
_DOOR_ROOM = 16
"""Depth of the free floor on both sides of a door [grid cells of 0.05 m]."""

Size = tuple[float, float]
"""Width and height [m]."""
Point = tuple[float, float]
"""Position (x, y) [m]."""
Rect = tuple[int, int, int, int]
"""Half-open rectangle (x0, y0, x1, y1) [grid cells of 0.05 m]."""
Disc = tuple[float, float, float]
"""Disc (x, y, radius) [grid cells of 0.05 m]."""
Wall = tuple[bool, int, int]
"""Shared wall of two rooms: True if vertical; start and end along the wall [grid cells of 0.05 m]."""


def units(metres: float) -> int:
    """Convert a length [m] to a whole number of grid cells of 0.05 m."""
    return round(metres / UNIT)


def mirror(rect: Rect) -> Rect:
    """Return a rectangle with x and y swapped."""
    return rect[1], rect[0], rect[3], rect[2]


def extent(room: Rect, side: int) -> tuple[int, int]:
    """Return the length of a room's wall, and the depth of the room behind the wall [grid cells].

    `side`: 0 south, 1 east, 2 north, 3 west.
    """
    width, height = room[2] - room[0], room[3] - room[1]
    return (width, height) if side % 2 == 0 else (height, width)


def is_one_piece(blocked: np.ndarray) -> bool:
    """Return True if the cells that are not blocked form one connected component."""
    return bool(ndimage.label(~blocked)[1] == 1)


@dataclass(frozen=True, slots=True)
class Item:
    """Piece of furniture as rectangles and discs [grid cells], with x along the wall and y away from the wall."""

    length: int
    depth: int
    rects: tuple[Rect, ...] = ()
    discs: tuple[Disc, ...] = ()


class FloorPlan:
    """Floor plan on a grid. Order of calls: set walls, open doors, `settle`, put furniture."""

    def __init__(self, size: Size, wall: int, is_open: bool = False) -> None:
        self.width, self.height = units(size[0]), units(size[1])
        self.floor: Rect = (wall, wall, self.width - wall, self.height - wall)
        self._is_open = is_open
        self.solid = np.ones((self.height, self.width), dtype=bool)
        self.solid[wall:-wall, wall:-wall] = False
        self.blocked = np.empty_like(self.solid)
        """Cells that the robot's centre cannot occupy: shape (height, width), bool."""
        self.reserved = np.zeros_like(self.solid)
        """Cells kept free of furniture: shape (height, width), bool."""
        self.discs: list[Disc] = []

    def open_door(self, rng: np.random.Generator, a: Rect, b: Rect, wall: Wall, width: int) -> int:
        """Cut a door into the wall between two rooms; return the door's start along the wall [grid cells]."""
        upright, low, high = wall
        slack = high - low - width - 6
        start = low + 3 + (int(rng.choice([0, slack])) if rng.random() < 0.5 else int(rng.integers(slack + 1)))
        p, q = (a, b) if upright else (mirror(a), mirror(b))
        left = min(p[2], q[2])
        solid, reserved = (self.solid, self.reserved) if upright else (self.solid.T, self.reserved.T)
        solid[start : start + width, left : left + INNER] = False
        reserved[start : start + width, left - _DOOR_ROOM : left + INNER + _DOOR_ROOM] = True
        return start

    def settle(self) -> None:
        """Compute the cells that the robot's centre can occupy, after all walls and doors are set."""
        self.blocked = ndimage.maximum_filter(self.solid, 2 * ROBOT_HALF_SIDE + 1, mode="constant", cval=True)

    def put(self, item: Item, room: Rect, side: int, along: int, gap: int = 0) -> bool:
        """Place furniture if it fits and the free space stays connected; return True if placed.

        `side`: wall behind the furniture, 0 south, 1 east, 2 north, 3 west; `along`: distance along this wall from the
        room's lower or left corner; `gap`: distance from this wall [grid cells].
        """
        x0, y0, x1, y1 = turn((0, gap, item.length, gap + item.depth), room, side, along)
        if x0 < room[0] or y0 < room[1] or x1 > room[2] or y1 > room[3]:
            return False
        if self.solid[y0:y1, x0:x1].any() or self.reserved[y0:y1, x0:x1].any():
            return False
        rects = [turn((a, b + gap, c, d + gap), room, side, along) for a, b, c, d in item.rects]
        turned = [turn((x, y + gap, x, y + gap), room, side, along) for x, y, _ in item.discs]
        discs = [(x, y, radius) for (x, y, _, _), (_, _, radius) in zip(turned, item.discs)]
        reach = ROBOT_HALF_SIDE
        grown = [(a - reach, b - reach, c + reach, d + reach) for a, b, c, d in rects]
        for x, y, radius in discs:
            far = radius + reach
            grown.append((math.floor(x - far), math.floor(y - far), math.ceil(x + far), math.ceil(y + far)))
        low_x, low_y, high_x, high_y = zip(*grown)
        nearby = self.blocked[max(min(low_y) - 1, 0) : max(high_y) + 1, max(min(low_x) - 1, 0) : max(high_x) + 1]
        before = nearby.copy()
        for a, b, c, d in grown:
            self.blocked[max(b, 0) : d, max(a, 0) : c] = True
        # Check the whole area only if the neighbourhood is not connected.
        x0_whole, y0_whole, x1_whole, y1_whole = self.floor if self._is_open else room
        if not is_one_piece(nearby) and not is_one_piece(self.blocked[y0_whole:y1_whole, x0_whole:x1_whole]):
            nearby[:] = before
            return False
        for a, b, c, d in rects:
            self.solid[b:d, a:c] = True
        self.reserved[y0:y1, x0:x1] = True
        self.discs += discs
        return True

    def put_somewhere(
        self, rng: np.random.Generator, item: Item, room: Rect, margin: int = 0, attempts: int = 4
    ) -> None:
        """Try to place furniture at `attempts` random positions in a room.

        `margin`: minimum distance from walls [grid cells], or 0 for a position at a wall.
        """
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
        """Return the plan as a world with a random collision-free start pose."""
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
    """Return a world of given segments and circles inside a rectangular outer wall, with a random start heading."""
    x, y = map(float, spawn)
    width, height = map(float, size)
    outer_walls = edges(box(0.5 * width, 0.5 * height, width, height))
    return World(
        name=name,
        segments=np.vstack([outer_walls, segments]),
        circles=circles,
        spawns=(Pose2D(x, y, float(rng.uniform(-math.pi, math.pi))),),
        bounds=(0.0, 0.0, width, height),
        source="generated",
        licence="MIT",
        notes=notes,
    )


def with_goals(world: World, trips: Sequence[tuple[Point, Point]]) -> World:
    """Return a copy of a world with start and goal poses at pairs of positions (start, goal) [m]."""
    headings = [math.atan2(goal[1] - start[1], goal[0] - start[0]) for start, goal in trips]
    spawns = tuple(Pose2D(*start, theta) for (start, _), theta in zip(trips, headings))
    return replace(world, spawns=spawns, goals=tuple(Pose2D(*goal, theta) for (_, goal), theta in zip(trips, headings)))


def turn(rect: Any, room: Rect, side: int, along: int) -> Any:
    """Transform a rectangle from wall coordinates to floor plan coordinates [grid cells].

    Wall coordinates: x along wall `side` of a room from position `along`, y into the room.
    """
    a, b, c, d = rect
    x0, y0, x1, y1 = room
    return (
        (x0 + along + a, y0 + b, x0 + along + c, y0 + d),
        (x1 - d, y0 + along + a, x1 - b, y0 + along + c),
        (x0 + along + a, y1 - d, x0 + along + c, y1 - b),
        (x0 + b, y0 + along + a, x0 + d, y0 + along + c),
    )[side]


def shared_wall(a: Rect, b: Rect) -> Wall | None:
    """Return the shared wall of two rooms, or None if no shared wall is long enough for a door."""
    for upright in (True, False):
        p, q = (a, b) if upright else (mirror(a), mirror(b))
        if p[2] + INNER == q[0] or q[2] + INNER == p[0]:
            low, high = max(p[1], q[1]), min(p[3], q[3])
            if high - low >= 28:
                return upright, low, high
    return None


def touching_pairs(rooms: list[Rect]) -> list[tuple[int, int, Wall]]:
    """Return all pairs of rooms with a shared wall long enough for a door: (i, j, wall), i < j."""
    x0, y0, x1, y1 = np.array(rooms, dtype=int).reshape(-1, 4).T
    touching = (x1[:, None] + INNER == x0) | (y1[:, None] + INNER == y0)
    pairs = np.argwhere(np.tril(touching | touching.T, -1)).tolist()
    return [(i, j, wall) for j, i in pairs if (wall := shared_wall(rooms[i], rooms[j]))]

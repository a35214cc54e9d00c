"""Doors in the walls between the rooms of a plan."""

import numpy as np

from .plan import Plan, Rect, mirror

INNER = 2
"""Thickness of inner walls [units]."""
_DOOR_ROOM = 16
"""How far before a door the floor stays empty [units]."""

Wall = tuple[bool, int, int]
"""Whether a wall is upright, and from where to where along it two rooms touch [units]."""


def shared_wall(a: Rect, b: Rect) -> Wall | None:
    """Return how two rooms touch: whether through an upright wall, and from where to where; None if they do not."""
    for upright in (True, False):
        p, q = (a, b) if upright else (mirror(a), mirror(b))
        if p[2] + INNER == q[0] or q[2] + INNER == p[0]:
            low, high = max(p[1], q[1]), min(p[3], q[3])
            if high - low >= 28:
                return upright, low, high
    return None


def open_door(rng: np.random.Generator, plan: Plan, a: Rect, b: Rect, wall: Wall, width: int) -> int:
    """Cut a door of `width` into the wall between two rooms and keep the floor before it empty.

    Returns:
        Where the door begins along the wall [units].
    """
    upright, low, high = wall
    # Most doors are near a corner, as in real houses.
    slack = high - low - width - 6
    start = low + 3 + (int(rng.choice([0, slack])) if rng.random() < 0.5 else int(rng.integers(slack + 1)))
    p, q = (a, b) if upright else (mirror(a), mirror(b))
    left = min(p[2], q[2])
    solid, reserved = (plan.solid, plan.reserved) if upright else (plan.solid.T, plan.reserved.T)
    solid[start : start + width, left : left + INNER] = False
    reserved[start : start + width, left - _DOOR_ROOM : left + INNER + _DOOR_ROOM] = True
    return start


def touching_pairs(rooms: list[Rect]) -> list[tuple[int, int, Wall]]:
    """Return the pairs of rooms (i < j) with enough of a wall between them for a door, and that wall."""
    x0, y0, x1, y1 = np.array(rooms, dtype=int).reshape(-1, 4).T
    touching = (x1[:, None] + INNER == x0) | (y1[:, None] + INNER == y0)
    pairs = np.argwhere(np.tril(touching | touching.T, -1)).tolist()
    return [(i, j, wall) for j, i in pairs if (wall := shared_wall(rooms[i], rooms[j]))]

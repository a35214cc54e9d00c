"""Where people end up in a step: not in each other, not in walls, not in robots."""

import math

import numpy as np
from numba import njit

from . import records as at
from .walls import clearance, push_out

MAX_OVERLAP = 0.02
"""Deepest overlap of two people [m]."""
_ROUNDS = 6
"""How often people are pushed apart in a step."""
MAX_HASTE = 1.5
"""Greatest speed at which a person moves, pushed or not, over the desired one."""
_TOLERANCE = 2e-6
"""Overlap with walls that does not count [m]."""


@njit(cache=True, error_model="numpy")
def settle(people, starts, robots, walls, dt):
    """Move people apart who overlap, and out of walls; who still has no room, or met a robot, stays where it came from.

    So nobody ends in a wall, and two people no deeper in each other than `MAX_OVERLAP`, as long as they began so.
    People on fixed routes make way for nobody, and walk through walls and each other.

    `people`: rows, at the positions that they want to take; `starts`: shape (n, 2), float64, where they come from [m];
    `robots`: shape (m, 5), float64, see `social_forces`; `walls`: `Walls`; `dt`: how long the step takes [s]. Returns
    for each the robot that stopped it, or -1: shape (n,), int64; `BLOCKED` is written for these.
    """
    count = people.shape[0]
    stopped_by, is_free = np.full(count, -1), False
    for _ in range(_ROUNDS):
        is_free = not _push_apart(people)
        for i in range(count):
            if people[i, at.KIND] <= at.BLIND:
                x, y = people[i, at.X], people[i, at.Y]
                people[i, at.X], people[i, at.Y], has_room = push_out(walls, x, y, people[i, at.RADIUS])
                is_free &= has_room and people[i, at.X] == x and people[i, at.Y] == y
        if is_free:
            break
    for i in range(count):
        dx, dy = people[i, at.X] - starts[i, 0], people[i, at.Y] - starts[i, 1]
        distance, longest = math.hypot(dx, dy), MAX_HASTE * people[i, at.SPEED] * dt
        if people[i, at.KIND] <= at.BLIND and distance > longest:
            people[i, at.X] = starts[i, 0] + longest / distance * dx
            people[i, at.Y] = starts[i, 1] + longest / distance * dy
            is_free = False
        stopped_by[i] = _robot_ahead(people[i], starts[i], robots, dt)
        if stopped_by[i] >= 0:
            people[i, at.X], people[i, at.Y] = starts[i, 0], starts[i, 1]
            is_free = False
    while not is_free:
        is_free = not _take_back(people, starts, walls)
    return stopped_by


@njit(cache=True, error_model="numpy")
def _push_apart(people):
    """Move those apart who overlap, each by half; return whether there were any."""
    found = False
    for i in range(people.shape[0]):
        for j in range(i):
            dx, dy = people[i, at.X] - people[j, at.X], people[i, at.Y] - people[j, at.Y]
            reach = people[i, at.RADIUS] + people[j, at.RADIUS]
            square = dx * dx + dy * dy
            if square >= reach * reach:
                continue
            gives_i, gives_j = people[i, at.KIND] <= at.BLIND, people[j, at.KIND] <= at.BLIND
            if not (gives_i or gives_j):
                continue
            found = True
            distance = math.sqrt(square)
            nx, ny = (dx / distance, dy / distance) if distance > 0.0 else (1.0, 0.0)
            depth = reach - distance
            share = 0.5 * gives_i if gives_j else 1.0
            people[i, at.X] += share * depth * nx
            people[i, at.Y] += share * depth * ny
            people[j, at.X] -= (1.0 - share) * depth * nx
            people[j, at.Y] -= (1.0 - share) * depth * ny
    return found


@njit(cache=True, error_model="numpy")
def _robot_ahead(person, start, robots, dt):
    """Return which robot a person that comes from `start` would walk into, or -1; who walks away from one does not."""
    for k in range(robots.shape[0]):
        distance = math.hypot(robots[k, 0] - person[at.X], robots[k, 1] - person[at.Y])
        before = math.hypot(robots[k, 0] - start[0], robots[k, 1] - start[1])
        if distance < robots[k, 2] + person[at.RADIUS] and distance < before:
            person[at.BLOCKED] = max(person[at.BLOCKED], (before - distance) / dt)
            return k
    return -1


@njit(cache=True, error_model="numpy")
def _take_back(people, starts, walls):
    """Put those back where they came from who are in a wall or too deep in somebody; return whether any moved."""
    moved = False
    for i in range(people.shape[0]):
        walks = people[i, at.KIND] <= at.BLIND
        if walks and clearance(walls, people[i, at.X], people[i, at.Y]) < people[i, at.RADIUS] - _TOLERANCE:
            moved |= _put_back(people[i], starts[i])
        for j in range(i):
            if not walks and people[j, at.KIND] > at.BLIND:
                continue
            dx, dy = people[i, at.X] - people[j, at.X], people[i, at.Y] - people[j, at.Y]
            least = people[i, at.RADIUS] + people[j, at.RADIUS] - MAX_OVERLAP
            if dx * dx + dy * dy < least * least:
                moved |= _put_back(people[i], starts[i])
                moved |= _put_back(people[j], starts[j])
    return moved


@njit(cache=True, error_model="numpy")
def _put_back(person, start):
    """Put a person where it came from; return whether it moves by that."""
    moved = person[at.X] != start[0] or person[at.Y] != start[1]
    person[at.X], person[at.Y] = start[0], start[1]
    return moved

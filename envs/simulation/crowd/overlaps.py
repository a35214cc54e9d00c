"""Collision resolution between people, walls and robots."""

import math

import numpy as np

from lidarnaut.envs.compilation import njit

from . import person_row as at
from .walls import clearance, push_out

MAX_OVERLAP = 0.02
"""Overlap above which two people return to their previous positions [m]."""
_ROUNDS = 6
MAX_SPEED_RATIO = 1.5
"""Maximum speed of a pushed person, divided by the desired speed."""
STOP_GAP = 1e-4
"""Gap between person and robot when a person stops at a robot [m]."""
_TOLERANCE = 2e-6


@njit(cache=True, error_model="numpy")
def resolve_overlaps(people, starts, robots, walls, dt):
    """Separate overlapping people, push people out of walls, and stop people at robots.

    People that still overlap return to `starts`, shape (n, 2), float64 [m]. People on fixed routes do not avoid anyone.
    `people`: state vectors with desired positions, updated. `robots`: discs (x, y, vx, vy, radius), shape (m, 5),
    float64 [m, m/s].

    Returns:
        Index of the robot that stopped each person, or -1: shape (n,), int64.
    """
    count, (near, grid) = people.shape[0], walls
    stopped_by, is_free = np.full(count, -1), False
    for _ in range(_ROUNDS):
        is_free = not _push_apart(people)
        for i in range(count):
            x, y = people[i, at.X], people[i, at.Y]
            if people[i, at.KIND] <= at.BLIND:
                new_x, new_y, has_room = push_out(near, grid, x, y, people[i, at.RADIUS])
                people[i, at.X], people[i, at.Y] = new_x, new_y
                is_free &= has_room and new_x == x and new_y == y
        if is_free:
            break
    for i in range(count):
        dx, dy = people[i, at.X] - starts[i, 0], people[i, at.Y] - starts[i, 1]
        longest = MAX_SPEED_RATIO * people[i, at.SPEED] * dt
        if people[i, at.KIND] <= at.BLIND and dx * dx + dy * dy > longest * longest:
            share = longest / math.sqrt(dx * dx + dy * dy)
            people[i, at.X], people[i, at.Y] = starts[i, 0] + share * dx, starts[i, 1] + share * dy
            is_free = False
        stopped_by[i] = _robot_ahead(people, i, starts, robots, dt)
        if stopped_by[i] >= 0:
            share = _share_until(people[i], starts[i], robots[stopped_by[i]])
            people[i, at.X] = starts[i, 0] + share * (people[i, at.X] - starts[i, 0])
            people[i, at.Y] = starts[i, 1] + share * (people[i, at.Y] - starts[i, 1])
            is_free = False
    while not is_free:
        is_free = not _take_back(people, starts, walls)
    return stopped_by


@njit(cache=True, error_model="numpy")
def _push_apart(people):
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


@njit(cache=True, error_model="numpy", inline="always")
def _robot_ahead(people, i, starts, robots, dt):
    for k in range(robots.shape[0]):
        dx, dy = robots[k, at.X] - people[i, at.X], robots[k, at.Y] - people[i, at.Y]
        reach = robots[k, at.RADIUS] + people[i, at.RADIUS]
        if dx * dx + dy * dy < reach * reach:
            closer = math.hypot(robots[k, at.X] - starts[i, 0], robots[k, at.Y] - starts[i, 1]) - math.hypot(dx, dy)
            if closer > 0.0:
                people[i, at.BLOCKED] = max(people[i, at.BLOCKED], closer / dt)
                return k
    return -1


@njit(cache=True, error_model="numpy")
def _share_until(person, start, robot):
    dx, dy = person[at.X] - start[0], person[at.Y] - start[1]
    away_x, away_y = start[0] - robot[at.X], start[1] - robot[at.Y]
    reach = robot[at.RADIUS] + person[at.RADIUS] + STOP_GAP
    gap, closing, length = away_x**2 + away_y**2 - reach * reach, away_x * dx + away_y * dy, dx * dx + dy * dy
    root = closing * closing - length * gap
    return 0.0 if gap <= 0.0 or root < 0.0 else min(max((-closing - math.sqrt(root)) / length, 0.0), 1.0)


@njit(cache=True, error_model="numpy")
def _take_back(people, starts, walls):
    moved, (near, grid) = False, walls
    for i in range(people.shape[0]):
        walks = people[i, at.KIND] <= at.BLIND
        gap = clearance(near, grid, people[i, at.X], people[i, at.Y])
        if walks and gap < people[i, at.RADIUS] - _TOLERANCE:
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
    moved = person[at.X] != start[0] or person[at.Y] != start[1]
    person[at.X], person[at.Y] = start[0], start[1]
    return moved

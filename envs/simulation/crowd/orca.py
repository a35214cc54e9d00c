"""ORCA pedestrian model.

Van den Berg, Guy, Lin and Manocha, "Reciprocal n-body collision avoidance" (2011). Half-planes of permitted velocities
are stored as (x, y, along_x, along_y): a border point [m/s], and the unit vector along the border with the permitted
side on its left.
"""

import math
from typing import NamedTuple

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry.rows import write_row

from . import person_row as at
from .social_force import Positive
from .walls import near_list, offset


class Orca(NamedTuple):
    """Parameters of the ORCA pedestrian model."""

    horizon: Positive = 5.0
    """Time horizon for avoiding people and robots [s]."""
    wall_horizon: Positive = 0.5
    """Time horizon for avoiding walls [s]."""
    sight: Positive = 4.0
    """Distance between centres above which people ignore each other and robots [m]."""
    margin: Positive = 0.05
    """Clearance that people keep to other people and to robots [m]."""
    excess: Positive = 1.3
    """Maximum walking speed, divided by the desired speed."""


NUM_ORCA = len(Orca._fields)
_EPSILON = 1e-9


@njit(cache=True, error_model="numpy")
def walk_by_orca(people, directions, robots, walls, model, dt):
    """Move the walking people by one time step `dt` [s] with the ORCA model.

    Two walking people each make half of the evasive velocity change. Avoiding walls has priority. `people`: state
    vectors, updated.
    """
    count, (near, grid) = people.shape[0], walls
    most = 0
    for i in range(count):
        first, end = near_list(near, grid, people[i, at.X], people[i, at.Y])
        most = max(most, end - first)
    others = np.concatenate((people[:, : at.RADIUS + 1], robots))
    velocities, lines = np.zeros((count, 2)), np.empty((most + len(others), 4))
    for i in range(count):
        if people[i, at.KIND] > at.BLIND:
            continue
        x, y, radius, speed = people[i, at.X], people[i, at.Y], people[i, at.RADIUS], people[i, at.SPEED]
        own = (people[i, at.VX], people[i, at.VY])
        num_lines = num_walls = _add_walls(lines, people, i, near, grid, model.wall_horizon, dt)
        for j in range(len(others) if people[i, at.KIND] == at.ATTENTIVE else count):
            away, velocity = (others[j, at.X] - x, others[j, at.Y] - y), (others[j, at.VX], others[j, at.VY])
            if j != i and away[0] * away[0] + away[1] * away[1] < model.sight * model.sight:
                reach = radius + others[j, at.RADIUS] + model.margin
                share = 0.5 if j < count and people[j, at.KIND] <= at.BLIND else 1.0
                avoid(lines, num_lines, away, own, velocity, reach, model.horizon, dt, share)
                num_lines += 1
        desired = (speed * directions[i, 0], speed * directions[i, 1])
        found = best_velocity(lines, num_lines, num_walls, desired, model.excess * speed)
        velocities[i, 0], velocities[i, 1] = found
    for i in range(count):
        people[i, at.X] += dt * velocities[i, 0]
        people[i, at.Y] += dt * velocities[i, 1]


@njit(cache=True, error_model="numpy", inline="always")
def _add_walls(lines, people, i, near, grid, horizon, dt):
    x, y, radius, own = people[i, at.X], people[i, at.Y], people[i, at.RADIUS], (people[i, at.VX], people[i, at.VY])
    first, end = near_list(near, grid, x, y)
    count = np.int64(0)  # a literal would compile the linear program twice
    for k in range(first, end):
        item = int(near[k])
        nx, ny, gap = offset(near, item, x, y)
        if gap > radius + 2.0 * horizon * people[i, at.SPEED]:
            continue
        ex, ey, extra = near[item + 2] - near[item], near[item + 3] - near[item + 1], near[item + 4]
        length = math.hypot(ex, ey)
        if gap > radius and (length == 0.0 or abs(nx * ex + ny * ey) > 1e-6 * length):
            away = (-nx * (gap + extra), -ny * (gap + extra))
            avoid(lines, count, away, own, (0.0, 0.0), radius + extra, horizon, dt, 1.0)
        else:
            speed = (radius - gap) / horizon
            lines[count, 0], lines[count, 1], lines[count, 2], lines[count, 3] = speed * nx, speed * ny, ny, -nx
        count += 1
    return count


@njit(cache=True, error_model="numpy", inline="always")
def avoid(lines, k, away, own, other, reach, horizon, dt, share):
    """Compute the half-plane of a person's velocities that avoid a moving disc (equation 5 of the ORCA paper).

    `lines[k]`: output. `away`: position of the disc relative to the person [m]. `own`, `other`: velocities of person
    and disc [m/s]. `reach`: sum of the radii [m]. `horizon`: time without collision [s]. `dt`: time until an existing
    overlap ends [s]. `share`: person's fraction of the evasive velocity change.
    """
    px, py = away
    vx, vy = own[0] - other[0], own[1] - other[1]
    square, reach2 = px * px + py * py, reach * reach
    rate = 1.0 / (horizon if square > reach2 else dt)
    wx, wy = vx - rate * px, vy - rate * py
    beyond, length2 = wx * px + wy * py, wx * wx + wy * wy
    if square <= reach2 or (beyond < 0.0 and beyond * beyond > reach2 * length2):
        length = math.sqrt(length2)
        ux, uy = wx / max(length, 1e-300), wy / max(length, 1e-300)
        change_x, change_y = (reach * rate - length) * ux, (reach * rate - length) * uy
        lines[k, 2], lines[k, 3] = uy, -ux
    else:
        leg = math.sqrt(square - reach2)
        side = 1.0 if px * wy - py * wx > 0.0 else -1.0
        ex, ey = (side * px * leg - py * reach) / square, (px * reach + side * py * leg) / square
        along = vx * ex + vy * ey
        change_x, change_y = along * ex - vx, along * ey - vy
        lines[k, 2], lines[k, 3] = ex, ey
    lines[k, 0], lines[k, 1] = own[0] + share * change_x, own[1] + share * change_y


@njit(cache=True, error_model="numpy")
def best_velocity(lines, num_lines, num_hard, desired, limit):
    """Return the permitted velocity (vx, vy) closest to `desired`, with a speed of at most `limit` [m/s].

    Permitted is the intersection of the half-planes `lines[:num_lines]`, shape (n, 4), float64. If it is empty, the
    largest violation is minimized, without violating the first `num_hard` half-planes (walls).
    """
    scale = min(1.0, limit / max(math.sqrt(desired[0] ** 2 + desired[1] ** 2), 1e-300))
    x, y, failed = _nearest_allowed(lines, num_lines, desired[0] * scale, desired[1] * scale, limit, desired, False)
    if failed < num_lines:
        x, y = _least_violation(lines, num_lines, num_hard, failed, x, y, limit)
    return x, y


@njit(cache=True, error_model="numpy")
def _nearest_allowed(lines, num_lines, x, y, limit, target, is_direction):
    for i in range(num_lines):
        px, py, ex, ey = lines[i, 0], lines[i, 1], lines[i, 2], lines[i, 3]
        if ex * (py - y) - ey * (px - x) <= 0.0:
            continue
        middle = px * ex + py * ey
        half = middle * middle + limit * limit - px * px - py * py
        if half < 0.0:
            return x, y, i
        half = math.sqrt(half)
        low, high = -middle - half, -middle + half
        for j in range(i):
            across = ex * lines[j, 3] - ey * lines[j, 2]
            height = lines[j, 2] * (py - lines[j, 1]) - lines[j, 3] * (px - lines[j, 0])
            if abs(across) <= _EPSILON:
                if height < 0.0:
                    return x, y, i
                continue
            if across > 0.0:
                high = min(high, height / across)
            else:
                low = max(low, height / across)
            if low > high:
                return x, y, i
        if is_direction:
            along = high if target[0] * ex + target[1] * ey > 0.0 else low
        else:
            along = min(max(ex * (target[0] - px) + ey * (target[1] - py), low), high)
        x, y = px + along * ex, py + along * ey
    return x, y, num_lines


@njit(cache=True, error_model="numpy")
def _least_violation(lines, num_lines, num_hard, first, x, y, limit):
    depth = 0.0
    equal = np.empty_like(lines)
    for i in range(first, num_lines):
        px, py, ex, ey = lines[i, 0], lines[i, 1], lines[i, 2], lines[i, 3]
        if ex * (py - y) - ey * (px - x) <= depth:
            continue
        for j in range(num_hard):
            write_row(equal[j], lines[j])
        count = num_hard
        for j in range(num_hard, i):
            across = ex * lines[j, 3] - ey * lines[j, 2]
            if abs(across) <= _EPSILON:
                if ex * lines[j, 2] + ey * lines[j, 3] > 0.0:
                    continue
                equal[count, 0], equal[count, 1] = 0.5 * (px + lines[j, 0]), 0.5 * (py + lines[j, 1])
            else:
                along = (lines[j, 2] * (py - lines[j, 1]) - lines[j, 3] * (px - lines[j, 0])) / across
                equal[count, 0], equal[count, 1] = px + along * ex, py + along * ey
            bx, by = lines[j, 2] - ex, lines[j, 3] - ey
            length = math.hypot(bx, by)
            equal[count, 2], equal[count, 3] = bx / length, by / length
            count += 1
        new_x, new_y, failed = _nearest_allowed(equal, count, -ey * limit, ex * limit, limit, (-ey, ex), True)
        if failed == count:
            x, y = new_x, new_y
        depth = ex * (py - y) - ey * (px - x)
    return x, y

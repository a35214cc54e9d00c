"""ORCA: each person takes the velocity nearest to the desired one that avoids everybody if the others do their half.

Van den Berg, Guy, Lin and Manocha, "Reciprocal n-body collision avoidance" (2011). Each neighbour allows a half plane
of velocities; the best one of all is found by an incremental linear program, and where there is none, the one that
violates them least. Lines are (x, y, along_x, along_y): a point and a unit vector; what lies to the left is allowed.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np
from numba import njit
from pydantic import Field

from . import records as at
from .social_force import Positive
from .walls import near_list, offset


class Orca(NamedTuple):
    """Parameters of ORCA."""

    horizon: Positive = 5.0
    """Time for which people avoid each other and robots [s]."""
    wall_horizon: Positive = 0.5
    """Time for which they avoid walls [s]."""
    sight: Positive = 5.0
    """Distance between centres up to which people see each other and robots [m]."""
    max_neighbors: Annotated[float, Field(ge=1.0, le=100.0)] = 10.0
    """How many of them, the nearest ones, are avoided."""
    margin: Positive = 0.05
    """Gap that is kept to others [m]."""
    excess: Positive = 1.3
    """Greatest speed over the desired one."""


NUM_ORCA = len(Orca._fields)
"""Number of these."""
_EPSILON = 1e-9
"""Sine of an angle between lines below which they count as parallel."""


@njit(cache=True, error_model="numpy")
def walk_by_orca(people, directions, robots, walls, model, dt):
    """Take attentive and blind people on by `dt` [s]; arguments as for `social_forces`, `model` is `Orca`.

    People do half of what avoids each other, and all of what avoids robots (attentive ones), who stands or walks along
    a fixed route, and walls, which no other half plane overrules.
    """
    count = people.shape[0]
    velocities = np.zeros((count, 2))
    lines = np.empty((walls.segments.shape[0] + walls.circles.shape[0] + int(model.max_neighbors) + robots.shape[0], 4))
    for i in range(count):
        person = people[i]
        if person[at.KIND] > at.BLIND:
            continue
        num_walls = _add_walls(lines, person, walls, model.wall_horizon, dt)
        num_lines = _add_people(lines, num_walls, people, i, model, dt)
        if person[at.KIND] == at.ATTENTIVE:
            for k in range(robots.shape[0]):
                dx, dy = robots[k, 0] - person[at.X], robots[k, 1] - person[at.Y]
                if dx * dx + dy * dy < model.sight * model.sight:
                    reach = robots[k, 2] + person[at.RADIUS] + model.margin
                    other = (robots[k, 3], robots[k, 4])
                    avoid(lines[num_lines], (dx, dy), person[at.VX : at.VY + 1], other, reach, model.horizon, dt, 1.0)
                    num_lines += 1
        desired = (person[at.SPEED] * directions[i, 0], person[at.SPEED] * directions[i, 1])
        limit = model.excess * person[at.SPEED]
        velocities[i, 0], velocities[i, 1] = best_velocity(lines[:num_lines], num_walls, desired, limit)
    for i in range(count):
        people[i, at.X] += dt * velocities[i, 0]
        people[i, at.Y] += dt * velocities[i, 1]


@njit(cache=True, error_model="numpy")
def _add_people(lines, num_lines, people, i, model, dt):
    """Append the lines of the people nearest to person i; return how many lines there are then."""
    person, most = people[i], int(model.max_neighbors)
    nearest, squares, found = np.empty(most, dtype=np.int64), np.empty(most), 0
    for j in range(people.shape[0]):
        dx, dy = people[j, at.X] - person[at.X], people[j, at.Y] - person[at.Y]
        square = dx * dx + dy * dy
        if j == i or square >= model.sight * model.sight or (found == most and square >= squares[most - 1]):
            continue
        k = min(found, most - 1)
        found = min(found + 1, most)
        while k > 0 and squares[k - 1] > square:
            squares[k], nearest[k] = squares[k - 1], nearest[k - 1]
            k -= 1
        squares[k], nearest[k] = square, j
    for k in range(found):
        other = people[nearest[k]]
        offset_x, offset_y = other[at.X] - person[at.X], other[at.Y] - person[at.Y]
        share = 0.5 if other[at.KIND] <= at.BLIND else 1.0
        reach = person[at.RADIUS] + other[at.RADIUS] + model.margin
        velocity = (other[at.VX], other[at.VY])
        line = lines[num_lines + k]
        avoid(line, (offset_x, offset_y), person[at.VX : at.VY + 1], velocity, reach, model.horizon, dt, share)
    return num_lines + found


@njit(cache=True, error_model="numpy")
def _add_walls(lines, person, walls, horizon, dt):
    """Write the lines of near walls; return how many. Ends of segments and circles are round, segments straight."""
    first, end = near_list(walls, person[at.X], person[at.Y])
    count, radius = 0, person[at.RADIUS]
    for k in range(first, end):
        item = int(walls.near[k])
        nx, ny, gap = offset(walls, item, person[at.X], person[at.Y])
        if gap > radius + horizon * 2.0 * person[at.SPEED]:
            continue
        is_round, extra = item >= walls.segments.shape[0], 0.0
        if is_round:
            extra = walls.circles[item - walls.segments.shape[0], 2]
        else:
            x0, y0, x1, y1 = walls.segments[item]
            across = abs(nx * (x1 - x0) + ny * (y1 - y0))
            is_round = across > 1e-6 * math.hypot(x1 - x0, y1 - y0)
        line = lines[count]
        if is_round and gap > radius:
            to_x, to_y = -nx * (gap + extra), -ny * (gap + extra)
            avoid(line, (to_x, to_y), person[at.VX : at.VY + 1], (0.0, 0.0), radius + extra, horizon, dt, 1.0)
        else:
            line[0], line[1] = nx * (radius - gap) / horizon, ny * (radius - gap) / horizon
            line[2], line[3] = ny, -nx
        count += 1
    return count


@njit(cache=True, error_model="numpy")
def avoid(line, to, own, other, reach, horizon, dt, share):
    """Write the line of velocities that avoid a disc, by the smallest change of the relative velocity (equation 5).

    `to`: its position from the person's [m]; `own`, `other`: velocities [m/s]; `reach`: sum of the radii [m];
    `horizon`: time for which they avoid each other [s], `dt` where they overlap [s]; `share`: of the change that the
    person does.
    """
    vx, vy = own[0] - other[0], own[1] - other[1]
    square = to[0] * to[0] + to[1] * to[1]
    rate = 1.0 / (horizon if square > reach * reach else dt)
    wx, wy = vx - rate * to[0], vy - rate * to[1]
    beyond = wx * to[0] + wy * to[1]
    length = math.sqrt(wx * wx + wy * wy)
    if square <= reach * reach or (beyond < 0.0 and beyond * beyond > reach * reach * length * length):
        scale = 1.0 / max(length, 1e-300)
        ux, uy = wx * scale, wy * scale
        line[2], line[3] = uy, -ux
        change = reach * rate - length
        change_x, change_y = change * ux, change * uy
    else:  # past one of the tangents
        leg = math.sqrt(square - reach * reach)
        side = 1.0 if to[0] * wy - to[1] * wx > 0.0 else -1.0
        line[2] = side * (to[0] * leg - side * to[1] * reach) / square
        line[3] = side * (side * to[0] * reach + to[1] * leg) / square
        along = vx * line[2] + vy * line[3]
        change_x, change_y = along * line[2] - vx, along * line[3] - vy
    line[0], line[1] = own[0] + share * change_x, own[1] + share * change_y


@njit(cache=True, error_model="numpy")
def best_velocity(lines, num_hard, desired, limit):
    """Return the velocity nearest to the desired one, no faster than `limit`, that all lines, shape (n, 4), allow.

    Where there is none, the one that the first `num_hard` lines allow and the others as nearly as possible [m/s].
    """
    scale = min(1.0, limit / max(math.hypot(desired[0], desired[1]), 1e-300))
    x, y, failed = _nearest_allowed(lines, desired[0] * scale, desired[1] * scale, limit, desired, False)
    if failed < lines.shape[0]:
        x, y = _least_violation(lines, num_hard, failed, x, y, limit)
    return x, y


@njit(cache=True, error_model="numpy")
def _nearest_allowed(lines, x, y, limit, target, is_direction):
    """Solve the linear program in two dimensions from its solution (x, y) without lines, adding one line at a time.

    What is sought is the velocity nearest to `target`, or the farthest one in this direction. Returns the solution of
    all lines before the first one that leaves none, and the index of that: the number of lines if all hold.
    """
    for i in range(lines.shape[0]):
        px, py, ex, ey = lines[i]
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
    return x, y, lines.shape[0]


@njit(cache=True, error_model="numpy")
def _least_violation(lines, num_hard, first, x, y, limit):
    """Solve the linear program in three dimensions: the hard lines hold, the others are violated as little as can be.

    (x, y) holds for all lines before `first`. A line that is violated more than all before it is the one to give way
    to, along the lines on which it and another one are violated equally.
    """
    depth = 0.0
    equal = np.empty_like(lines)
    for i in range(first, lines.shape[0]):
        px, py, ex, ey = lines[i]
        if ex * (py - y) - ey * (px - x) <= depth:
            continue
        equal[:num_hard] = lines[:num_hard]
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
        new_x, new_y, failed = _nearest_allowed(equal[:count], -ey * limit, ex * limit, limit, (-ey, ex), True)
        if failed == count:  # else rounding: the present solution is as good
            x, y = new_x, new_y
        depth = ex * (py - y) - ey * (px - x)
    return x, y

"""Social force model: people are drawn towards where they walk, and pushed by each other, by robots and by walls.

Helbing and Molnar, "Social force model for pedestrian dynamics" (1995), with circles of equal repulsion, discs for
bodies, and a share of the force beside its line, which lets two people pass who meet head-on.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np
from numba import njit
from pydantic import Field

from . import records as at
from .walls import near_list, offset

Positive = Annotated[float, Field(gt=0.0, le=100.0)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]


class SocialForce(NamedTuple):
    """Parameters of the social force model, which uses accelerations."""

    strength: Positive = 7.0
    """How strongly people push each other who touch [m/s2]; with the 2.1 of some libraries many collide."""
    reach: Positive = 0.3
    """Distance in which this falls by the factor e [m]."""
    behind: Share = 0.5
    """Weight of who is behind a person, where who is ahead has 1 (the anisotropy, lambda)."""
    sideways: Share = 0.3
    """Share of a push that acts across its line, to the right of who faces the other, so that two who meet pass."""
    braking: Positive = 1.0
    """Greatest push of other people against where a person walks, over what makes it walk: 1 stops it, and nobody walks
    backwards. Speed then falls with density as Weidmann (1993) measured it."""
    wall_strength: Positive = 6.0
    """How strongly a wall pushes a person who touches it [m/s2]."""
    wall_reach: Positive = 0.12
    """Distance in which this falls by the factor e [m]."""
    relaxation: Positive = 0.5
    """Time in which a person takes up the desired velocity (tau) [s]."""
    excess: Positive = 1.3
    """Greatest speed over the desired one."""
    max_acceleration: Positive = 12.0
    """Greatest acceleration [m/s2]."""


NUM_FORCES = len(SocialForce._fields)
"""Number of these."""
HESITATION = 0.5
"""Who has been slow for so long tries to pass on the other side [s]."""
NEGLIGIBLE = 1e-3
"""Pushes below this share of those at touch are left out."""


@njit(cache=True, error_model="numpy")
def social_forces(people, directions, robots, walls, model, forces):
    """Write the accelerations of all people to `forces`, shape (n, 2), float64 [m/s2].

    `people`: rows; `directions`: shape (n, 2), float64, unit vectors of where they walk; `robots`: shape (m, 5),
    float64, as the first entries of people; `walls`: `Walls`; `model`: `SocialForce`. All in the world frame [m, m/s].
    """
    count, (near, grid) = people.shape[0], walls
    cutoff = -model.reach * math.log(NEGLIGIBLE)
    forces[:] = 0.0
    for i in range(count):  # by indices: making a view of a row takes as long as a push
        x, y, radius = people[i, at.X], people[i, at.Y], people[i, at.RADIUS]
        for j in range(i):
            dx, dy = x - people[j, at.X], y - people[j, at.Y]
            touching = radius + people[j, at.RADIUS]
            square = dx * dx + dy * dy
            if square >= (touching + cutoff) ** 2:
                continue
            distance = math.sqrt(square)
            nx, ny = (dx / distance, dy / distance) if distance > 0.0 else (1.0, 0.0)
            push = model.strength * math.exp((touching - distance) / model.reach)
            _add(forces, i, push, nx, ny, people, directions, model)
            _add(forces, j, push, -nx, -ny, people, directions, model)
    for i in range(count):
        x, y, radius, speed = people[i, at.X], people[i, at.Y], people[i, at.RADIUS], people[i, at.SPEED]
        ahead_x, ahead_y = directions[i, 0], directions[i, 1]
        most = model.braking * speed / model.relaxation
        back = -(forces[i, 0] * ahead_x + forces[i, 1] * ahead_y)
        spared = back - most * (1.0 - math.exp(-back / most)) if back > 0.0 else 0.0
        forces[i, 0] += spared * ahead_x + (speed * ahead_x - people[i, at.VX]) / model.relaxation
        forces[i, 1] += spared * ahead_y + (speed * ahead_y - people[i, at.VY]) / model.relaxation
        for k in range(robots.shape[0] if people[i, at.KIND] == at.ATTENTIVE else 0):
            dx, dy = x - robots[k, at.X], y - robots[k, at.Y]
            distance, touching = math.sqrt(dx * dx + dy * dy), radius + robots[k, at.RADIUS]
            if 0.0 < distance < touching + cutoff:
                push = model.strength * math.exp((touching - distance) / model.reach)
                _add(forces, i, push, dx / distance, dy / distance, people, directions, model)
        push_x, push_y = wall_force(near, grid, x, y, radius, model)
        forces[i, 0] += push_x
        forces[i, 1] += push_y
        square = forces[i, 0] * forces[i, 0] + forces[i, 1] * forces[i, 1]
        if square > model.max_acceleration * model.max_acceleration:
            forces[i, 0] *= model.max_acceleration / math.sqrt(square)
            forces[i, 1] *= model.max_acceleration / math.sqrt(square)


@njit(cache=True, error_model="numpy", inline="always")
def _add(forces, i, push, nx, ny, people, directions, model):
    """Add a push along the unit vector (nx, ny), weighted by how far ahead it comes from (equation 8 as a cosine)."""
    ahead = -(nx * directions[i, 0] + ny * directions[i, 1])
    push *= model.behind + (1.0 - model.behind) * 0.5 * (1.0 + ahead)
    sideways = model.sideways if people[i, at.SLOW] < HESITATION else -model.sideways
    forces[i, 0] += push * (nx - sideways * ny)
    forces[i, 1] += push * (ny + sideways * nx)


@njit(cache=True, error_model="numpy", inline="always")
def wall_force(near, grid, x, y, radius, model):
    """Return the push of the obstacles of `Walls` on a person at (x, y) with a radius [m]: (ax, ay) [m/s2].

    To the left and to the right, down and up, the strongest push counts: a wall of many pieces pushes like one.
    """
    left = right = down = up = 0.0
    first, end = near_list(near, grid, x, y)
    for k in range(first, end):
        nx, ny, gap = offset(near, int(near[k]), x, y)
        push = model.wall_strength * math.exp((radius - gap) / model.wall_reach)
        left, right = min(left, push * nx), max(right, push * nx)
        down, up = min(down, push * ny), max(up, push * ny)
    return left + right, down + up


@njit(cache=True, error_model="numpy")
def walk_by_forces(people, directions, robots, walls, model, dt):
    """Take attentive and blind people on by `dt` [s] (semi-implicit Euler); arguments as for `social_forces`."""
    forces = np.empty((people.shape[0], 2))
    social_forces(people, directions, robots, walls, model, forces)
    for i in range(people.shape[0]):
        if people[i, at.KIND] > at.BLIND:
            continue
        vx, vy = people[i, at.VX] + dt * forces[i, 0], people[i, at.VY] + dt * forces[i, 1]
        slowed = min(1.0, model.excess * people[i, at.SPEED] / max(math.sqrt(vx * vx + vy * vy), 1e-300))
        people[i, at.X] += dt * slowed * vx
        people[i, at.Y] += dt * slowed * vy

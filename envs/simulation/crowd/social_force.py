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
NEGLIGIBLE = 1e-3
"""Pushes below this share of those at touch are left out."""


@njit(cache=True, error_model="numpy")
def social_forces(people, directions, robots, walls, model, forces):
    """Write the accelerations of all people to `forces`, shape (n, 2), float64 [m/s2].

    `people`: rows; `directions`: shape (n, 2), float64, unit vectors of where they walk; `robots`: shape (m, 5),
    float64, (x, y, radius, vx, vy); `walls`: `Walls`; `model`: `SocialForce`. All in the world frame [m, m/s].
    """
    count = people.shape[0]
    cutoff = -model.reach * math.log(NEGLIGIBLE)
    for i in range(count):
        person = people[i]
        forces[i, 0] = (person[at.SPEED] * directions[i, 0] - person[at.VX]) / model.relaxation
        forces[i, 1] = (person[at.SPEED] * directions[i, 1] - person[at.VY]) / model.relaxation
    for i in range(count):
        x, y, radius = people[i, at.X], people[i, at.Y], people[i, at.RADIUS]
        for j in range(i + 1, count):
            dx, dy = x - people[j, at.X], y - people[j, at.Y]
            most = radius + people[j, at.RADIUS] + cutoff
            square = dx * dx + dy * dy
            if square >= most * most:
                continue
            distance = math.sqrt(square)
            nx, ny = (dx / distance, dy / distance) if distance > 0.0 else (1.0, 0.0)
            push = model.strength * math.exp((most - cutoff - distance) / model.reach)
            _add(forces[i], push, nx, ny, directions[i], model)
            _add(forces[j], push, -nx, -ny, directions[j], model)
    for i in range(count):
        person = people[i]
        if person[at.KIND] == at.ATTENTIVE:
            for k in range(robots.shape[0]):
                dx, dy = person[at.X] - robots[k, 0], person[at.Y] - robots[k, 1]
                gap = math.sqrt(dx * dx + dy * dy) - person[at.RADIUS] - robots[k, 2]
                if gap < cutoff:
                    distance = gap + person[at.RADIUS] + robots[k, 2]
                    push = model.strength * math.exp(-gap / model.reach)
                    _add(forces[i], push, dx / distance, dy / distance, directions[i], model)
        push_x, push_y = wall_force(walls, person[at.X], person[at.Y], person[at.RADIUS], model)
        forces[i, 0] += push_x
        forces[i, 1] += push_y
        strength = math.hypot(forces[i, 0], forces[i, 1])
        if strength > model.max_acceleration:
            forces[i, 0] *= model.max_acceleration / strength
            forces[i, 1] *= model.max_acceleration / strength


@njit(cache=True, error_model="numpy", inline="always")
def _add(force, push, nx, ny, direction, model):
    """Add a push along the unit vector (nx, ny), weighted by how far ahead it comes from (equation 8 as a cosine)."""
    ahead = -(nx * direction[0] + ny * direction[1])
    push *= model.behind + (1.0 - model.behind) * 0.5 * (1.0 + ahead)
    force[0] += push * (nx - model.sideways * ny)
    force[1] += push * (ny + model.sideways * nx)


@njit(cache=True, error_model="numpy")
def wall_force(walls, x, y, radius, model):
    """Return the push of static obstacles on a person at (x, y) with a radius [m]: (ax, ay) [m/s2].

    To the left and to the right, down and up, the strongest push counts: a wall of many pieces pushes like one.
    """
    left = right = down = up = 0.0
    first, end = near_list(walls, x, y)
    for k in range(first, end):
        nx, ny, gap = offset(walls, int(walls.near[k]), x, y)
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
        person = people[i]
        if person[at.KIND] > at.BLIND:
            continue
        vx, vy = person[at.VX] + dt * forces[i, 0], person[at.VY] + dt * forces[i, 1]
        slowed = min(1.0, model.excess * person[at.SPEED] / max(math.hypot(vx, vy), 1e-300))
        person[at.X] += dt * slowed * vx
        person[at.Y] += dt * slowed * vy

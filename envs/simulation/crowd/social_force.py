"""Social force pedestrian model.

Helbing and Molnar, "Social force model for pedestrian dynamics" (1995), with circular repulsion and a sideways force
for head-on encounters.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.robots.robot_params import Share

from . import person_row as at
from .walls import near_list, offset

Positive = Annotated[float, Field(gt=0.0, le=100.0)]


class SocialForce(NamedTuple):
    """Parameters of the social force model. Forces are accelerations."""

    strength: Positive = 7.0
    """Acceleration by repulsion between two people in contact [m/s2]."""
    reach: Positive = 0.3
    """Distance over which repulsion between people falls by the factor e [m]."""
    behind: Share = 0.5
    """Weight of repulsion from people behind, relative to people ahead (anisotropy lambda)."""
    sideways: Share = 0.3
    """Force to the right for passing others, divided by their repulsion."""
    braking: Positive = 1.0
    """Maximum backward push by all other people on a person, divided by the driving force (desired speed /
    `relaxation`). At 1, people stop in a dense crowd (Weidmann, 1993)."""
    wall_strength: Positive = 6.0
    """Acceleration by repulsion of a wall in contact with a person [m/s2]."""
    wall_reach: Positive = 0.12
    """Distance over which wall repulsion falls by the factor e [m]."""
    relaxation: Positive = 0.5
    """Relaxation time tau towards the desired velocity [s]."""
    excess: Positive = 1.3
    """Maximum walking speed, divided by the desired speed."""
    max_acceleration: Positive = 12.0
    """Maximum acceleration [m/s2]."""


NUM_FORCES = len(SocialForce._fields)
SIDE_SWITCH_TIME = 0.5
"""Time of slow walking after which a person evades to the left instead of the right [s]."""
MIN_PUSH_RATIO = 1e-3
"""Repulsion between two bodies is neglected below this fraction of the repulsion in contact."""


@njit(cache=True, error_model="numpy")
def social_forces(people, directions, robots, walls, model, forces):
    """Compute the accelerations of people by the social force model.

    `people`: state vectors. `directions`: walking directions, shape (n, 2), float64, unit vectors. `robots`: discs (x,
    y, vx, vy, radius), shape (m, 5), float64 [m, m/s]. `forces`: output, shape (n, 2), float64, world frame [m/s2].
    """
    count, (near, grid) = people.shape[0], walls
    cutoff = -model.reach * math.log(MIN_PUSH_RATIO)
    forces[:] = 0.0
    for i in range(count):
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
    ahead = -(nx * directions[i, 0] + ny * directions[i, 1])
    push *= model.behind + (1.0 - model.behind) * 0.5 * (1.0 + ahead)
    sideways = model.sideways if people[i, at.SLOW] < SIDE_SWITCH_TIME else -model.sideways
    forces[i, 0] += push * (nx - sideways * ny)
    forces[i, 1] += push * (ny + sideways * nx)


@njit(cache=True, error_model="numpy", inline="always")
def wall_force(near, grid, x, y, radius, model):
    """Return the acceleration (ax, ay) of a person at (x, y) by the repulsion of walls [m/s2].

    Of the nearby walls, only the strongest component in each direction (+x, -x, +y, -y) counts.
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
    """Move the walking people by one time step `dt` [s] (semi-implicit Euler). `people`: state vectors, updated."""
    forces = np.empty((people.shape[0], 2))
    social_forces(people, directions, robots, walls, model, forces)
    for i in range(people.shape[0]):
        if people[i, at.KIND] > at.BLIND:
            continue
        vx, vy = people[i, at.VX] + dt * forces[i, 0], people[i, at.VY] + dt * forces[i, 1]
        slowed = min(1.0, model.excess * people[i, at.SPEED] / max(math.sqrt(vx * vx + vy * vy), 1e-300))
        people[i, at.X] += dt * slowed * vx
        people[i, at.Y] += dt * slowed * vy

"""One control period of people, and what lidars and robots meet of them."""

import math

import numpy as np
from numba import njit

from envs.simulation import records as robots_at

from . import records as at

SUBSTEP = 0.05
"""Longest time in which people walk straight on [s]."""
LEG_RADIUS, LEG_OFFSET, STRIDE = 0.06, 0.1, 0.35
"""Radius of a leg, its distance from the middle, and how far it swings ahead and back [m], at the height of a lidar."""


@njit(cache=True, error_model="numpy")
def step_people(people, points, fields, setup, robots, segments, circles):
    """Let people walk for one control period, before the robots move.

    `people`, `points`, `fields`, `setup`: see `People`, the first written; `robots`: rows of robots, see
    `envs.simulation.records`, of which those in contact with a person that walked into them are marked as touched;
    `segments`, `circles`: of the world, shapes (n, 4) and (m, 3), float64 [m].
    """
    period, radius = robots[0, robots_at.PERIOD], robots[0, robots_at.ROBOT]
    num_steps = max(1, math.ceil(period / SUBSTEP - 1e-9))
    dt = period / num_steps
    for i in range(people.shape[0]):
        person = people[i]
        person[at.BEFORE_X], person[at.BEFORE_Y], person[at.BLOCKED] = person[at.X], person[at.Y], 0.0
    for _ in range(num_steps):
        for i in range(people.shape[0]):
            person = people[i]
            x, y = person[at.X], person[at.Y]
            if person[at.KIND] == at.FIXED_ROUTE:
                _follow_route(person, points, dt)
            _stop_at_robots(person, x, y, robots, radius, dt)
    for i in range(people.shape[0]):
        person = people[i]
        dx, dy = person[at.X] - person[at.BEFORE_X], person[at.Y] - person[at.BEFORE_Y]
        person[at.VX], person[at.VY] = dx / period, dy / period
        walked = math.hypot(dx, dy)
        if walked > 0.0:
            person[at.HEADING] = math.atan2(dy, dx)
            person[at.PHASE] += math.pi * walked / STRIDE


@njit(cache=True, error_model="numpy")
def _follow_route(person, points, dt):
    """Walk on along a fixed route, around its corners."""
    left = person[at.SPEED] * dt
    while left > 0.0:
        goal = int(person[at.GOAL])
        dx, dy = points[goal, 0] - person[at.X], points[goal, 1] - person[at.Y]
        distance = math.hypot(dx, dy)
        if distance > left:
            person[at.X] += left * dx / distance
            person[at.Y] += left * dy / distance
            return
        person[at.X], person[at.Y], person[at.GOAL] = points[goal, 0], points[goal, 1], points[goal, 2]
        left -= distance


@njit(cache=True, error_model="numpy")
def _stop_at_robots(person, x, y, robots, radius, dt):
    """Put a person that has come from (x, y) into a robot back there, unless it walks away from the robot."""
    reach = radius + person[at.RADIUS]
    for k in range(robots.shape[0]):
        dx, dy = robots[k, robots_at.X] - person[at.X], robots[k, robots_at.Y] - person[at.Y]
        gap = dx * dx + dy * dy
        if gap >= reach * reach:
            continue
        from_x, from_y = robots[k, robots_at.X] - x, robots[k, robots_at.Y] - y
        distance = math.hypot(from_x, from_y)
        if gap >= distance * distance:
            continue
        closing = (distance - math.sqrt(gap)) / dt
        person[at.BLOCKED] = max(person[at.BLOCKED], closing)
        person[at.X], person[at.Y] = x, y
        robots[k, robots_at.TOUCHED] = 1.0
        return


@njit(cache=True, error_model="numpy")
def with_people(circles, people, column):
    """Return circles, shape (m, 3) [m], and after them people: their positions from a column of their rows on."""
    count = circles.shape[0]
    joined = np.empty((count + people.shape[0], 3))
    joined[:count] = circles
    for i in range(people.shape[0]):
        joined[count + i, 0], joined[count + i, 1] = people[i, column], people[i, column + 1]
        joined[count + i, 2] = people[i, at.RADIUS]
    return joined


@njit(cache=True, error_model="numpy")
def with_bodies(circles, people, setup):
    """Return circles, shape (m, 3) [m], and after them what lidars see of people: a disc of each, or two legs.

    Legs swing by turns, and rest beside each other at the end of a step.
    """
    if setup[1] == 0.0:
        return with_people(circles, people, at.X)
    count = circles.shape[0]
    joined = np.empty((count + 2 * people.shape[0], 3))
    joined[:count] = circles
    for i in range(people.shape[0]):
        person = people[i]
        c, s = math.cos(person[at.HEADING]), math.sin(person[at.HEADING])
        swing = 0.5 * STRIDE * math.sin(person[at.PHASE])
        for leg, side in enumerate((-1.0, 1.0)):
            ahead, left = side * swing, side * LEG_OFFSET
            row = joined[count + 2 * i + leg]
            row[0], row[1] = person[at.X] + c * ahead - s * left, person[at.Y] + s * ahead + c * left
            row[2] = LEG_RADIUS
    return joined

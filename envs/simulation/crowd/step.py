"""Motion of people, and the circles that represent people in contacts and scans."""

import math

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry.lookup import as_tuple
from lidarnaut.envs.geometry.rows import write_row
from lidarnaut.envs.simulation.records import TOUCHED_PERSON
from lidarnaut.envs.simulation.sensors import with_room

from . import person_row as at
from .orca import NUM_ORCA, Orca, walk_by_orca
from .overlaps import MAX_SPEED_RATIO, resolve_overlaps
from .routes import choose_directions
from .social_force import NUM_FORCES, SocialForce, walk_by_forces
from .walls import Walls

SUBSTEP, ORCA_SUBSTEP = 0.05, 0.1
"""Maximum time steps of the social force model and of ORCA [s]."""
LEG_RADIUS, LEG_OFFSET, STRIDE = 0.06, 0.1, 0.35
"""Radius of a leg, sideways distance of a leg from the body's centre, and stride length [m]."""
MAX_CORNERS = 100_000
"""Maximum number of waypoints that a person passes in a time step. Any `FixedRoute` of two points has fewer."""


@njit(cache=True, error_model="numpy")
def step_people(people, points, fields, setup, robots):
    """Move people by one control period, before the robots move.

    `people`: state vectors, updated. `robots`: records; `touched` is set for robots that people walk into. `points`,
    `fields`: destinations, and cost-to-go to each. `setup`: parameters, see `People.setup`.
    """
    period, radius, count = robots[0].period, robots[0].radius, people.shape[0]
    discs = np.empty((robots.shape[0], 5))
    for k in range(robots.shape[0]):
        robot, v = robots[k], robots[k].v
        discs[k, at.X], discs[k, at.Y], discs[k, at.RADIUS] = robot.x, robot.y, radius
        discs[k, at.VX], discs[k, at.VY] = v * math.cos(robot.theta), v * math.sin(robot.theta)
    grid = setup[at.ORIGIN_X], setup[at.ORIGIN_Y], setup[at.ROWS], setup[at.COLS]
    walls = Walls(setup[at.WALLS :], grid)
    before, starts, directions = np.empty((count, 2)), np.empty((count, 2)), np.empty((count, 2))
    longest = ORCA_SUBSTEP if setup[at.ORCA] > 0.0 else SUBSTEP
    for i in range(count):
        before[i, 0], before[i, 1], people[i, at.BLOCKED] = people[i, at.X], people[i, at.Y], 0.0
        if people[i, at.KIND] <= at.BLIND:  # prevents tunnelling through walls
            longest = min(longest, people[i, at.RADIUS] / (MAX_SPEED_RATIO * people[i, at.SPEED]))
    num_steps = max(1, math.ceil(period / longest - 1e-9))
    dt = period / num_steps
    for _ in range(num_steps):
        for i in range(count):
            starts[i, 0], starts[i, 1] = people[i, at.X], people[i, at.Y]
            if people[i, at.KIND] == at.FIXED_ROUTE:
                _follow_route(people[i], points, dt)
        if fields.shape[0] > 0:
            choose_directions(people, points, fields, grid, dt, directions)
            _walk(people, directions, discs, walls, setup, dt)
        stopped_by = resolve_overlaps(people, starts, discs, walls, dt)
        for i in range(count):
            people[i, at.VX] = (people[i, at.X] - starts[i, 0]) / dt
            people[i, at.VY] = (people[i, at.Y] - starts[i, 1]) / dt
            if stopped_by[i] >= 0:
                robots[stopped_by[i]].touched = TOUCHED_PERSON + i
    for i in range(count):
        dx, dy = people[i, at.X] - before[i, 0], people[i, at.Y] - before[i, 1]
        walked = math.hypot(dx, dy)
        if people[i, at.KIND] == at.FIXED_ROUTE:
            people[i, at.VX], people[i, at.VY] = dx / period, dy / period
        if walked > 0.0:
            people[i, at.HEADING] = math.atan2(dy, dx)
            people[i, at.PHASE] += math.pi * walked / STRIDE


@njit(cache=True, error_model="numpy")
def _walk(people, directions, discs, walls, setup, dt):
    if setup[at.ORCA] > 0.0:
        orca = Orca(*as_tuple(setup[at.MODEL :], NUM_ORCA))
        walk_by_orca(people, directions, discs, walls, orca, dt)
    else:
        forces = SocialForce(*as_tuple(setup[at.MODEL :], NUM_FORCES))
        walk_by_forces(people, directions, discs, walls, forces, dt)


@njit(cache=True, error_model="numpy")
def _follow_route(person, points, dt):
    left = person[at.SPEED] * dt
    for _ in range(MAX_CORNERS):
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
def with_people(circles, people, legs):
    """Return obstacle circles (x, y, radius) [m], followed by circles for people's bodies or swinging legs.

    `legs`: 1.0 for legs, 0.0 for bodies; numbers are passed to kernels faster than flags.
    """
    count = circles.shape[0]
    extended = with_room(circles, (2 if legs > 0.0 else 1) * people.shape[0])
    for i in range(people.shape[0]):
        person = people[i]
        if legs == 0.0:
            write_row(extended[count + i], (person[at.X], person[at.Y], person[at.RADIUS]))
            continue
        c, s = math.cos(person[at.HEADING]), math.sin(person[at.HEADING])
        swing = 0.5 * STRIDE * math.sin(person[at.PHASE])
        for leg, side in enumerate((-1.0, 1.0)):
            ahead, left = side * swing, side * LEG_OFFSET
            x, y = person[at.X] + c * ahead - s * left, person[at.Y] + s * ahead + c * left
            write_row(extended[count + 2 * i + leg], (x, y, LEG_RADIUS))
    return extended

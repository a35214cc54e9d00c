import math

import numpy as np
import pytest
from numba import njit

from lidarnaut.envs.geometry.clearance import segment_offset
from lidarnaut.envs.simulation.crowd import Crowd, social_force
from lidarnaut.envs.simulation.crowd import person_row as at
from lidarnaut.envs.simulation.crowd.overlaps import resolve_overlaps
from lidarnaut.envs.simulation.crowd.social_force import SocialForce
from lidarnaut.envs.simulation.crowd.walls import list_walls, near_list
from tests.crowds import CYLINDERS, begin


def reference(people, directions, robots, walls, model):

    def push(offset, touching, ahead, sideways):
        distance = np.hypot(*offset)
        if distance >= touching - model.reach * math.log(social_force.MIN_PUSH_RATIO):
            return np.zeros(2)
        normal = offset / distance
        weight = model.behind + (1.0 - model.behind) * (1.0 - normal @ ahead) / 2.0
        strength = weight * model.strength * math.exp((touching - distance) / model.reach)
        return strength * (normal + sideways * np.array([-normal[1], normal[0]]))

    forces = []
    for i, person in enumerate(people):
        at_i, ahead, radius = person[[at.X, at.Y]], directions[i], person[at.RADIUS]
        sideways = model.sideways if person[at.SLOW] < social_force.SIDE_SWITCH_TIME else -model.sideways
        others = sum(
            push(at_i - other[[at.X, at.Y]], radius + other[at.RADIUS], ahead, sideways)
            for j, other in enumerate(people)
            if j != i
        )
        drive = person[at.SPEED] / model.relaxation
        if (back := -others @ ahead) > 0.0:
            most = model.braking * drive
            others = others + (back - most * (1.0 - math.exp(-back / most))) * ahead
        force = others + drive * ahead - person[[at.VX, at.VY]] / model.relaxation
        if person[at.KIND] == at.ATTENTIVE:
            force += sum(push(at_i - robot[:2], radius + robot[4], ahead, sideways) for robot in robots)
        first, end = near_list(walls.near, walls.grid, *at_i)
        offsets = []
        for k in walls.near[first:end].astype(int):
            line = walls.near[k : k + 5]
            offset = np.array(segment_offset(*at_i, line[None], 0))
            offsets.append(offset * (1.0 - line[4] / np.hypot(*offset)))
        offsets.append((100.0, 100.0))
        gaps = np.hypot(*np.transpose(offsets))
        pushes = np.transpose(offsets) / gaps * model.wall_strength * np.exp((radius - gaps) / model.wall_reach)
        force += np.maximum(pushes, 0.0).max(axis=1) + np.minimum(pushes, 0.0).min(axis=1)
        forces.append(force * min(1.0, model.max_acceleration / np.hypot(*force)))
    return np.array(forces)


def random_people(rng, seed):
    people = begin(CYLINDERS, Crowd(number=25, attentive=0.5), seed).rows
    count = len(people)
    people[:, [at.VX, at.VY]] = rng.uniform(-1.0, 1.0, (count, 2))
    people[:, at.SLOW] = rng.choice([0.0, 1.0], size=count)
    angles = rng.uniform(-math.pi, math.pi, count)
    return people, np.column_stack([np.cos(angles), np.sin(angles)])


def forces_of(people, directions, robots, walls, model):
    forces = np.empty((len(people), 2))
    social_force.social_forces(people, directions, robots, walls, model, forces)
    return forces


@pytest.mark.parametrize("model", [SocialForce(), SocialForce(strength=2.1, behind=0.1, sideways=0.0, braking=3.0)])
def test_forces_are_those_of_the_reference(model):
    rng = np.random.default_rng(0)
    walls = list_walls(CYLINDERS.segments, CYLINDERS.circles, CYLINDERS.bounds, 0.3)
    robots = np.array([(0.5, 0.2, 1.0, 0.0, 0.3), (-2.0, 3.0, 0.0, 0.0, 0.2)])
    for seed in range(10):
        people, directions = random_people(rng, seed)
        expected = reference(people, directions, robots, walls, model)
        np.testing.assert_allclose(forces_of(people, directions, robots, walls, model), expected, atol=1e-9)


@njit
def mean_speed(people, walls, model, periods, first, dt):
    """Let people walk around a ring; return their mean speed along the ring from period `first` on [m/s]."""
    count, total = people.shape[0], 0.0
    directions, starts = np.empty((count, 2)), np.empty((count, 2))
    for period in range(periods):
        for i in range(count):
            x, y = people[i, at.X], people[i, at.Y]
            starts[i, 0], starts[i, 1] = x, y
            directions[i, 0], directions[i, 1] = -y / math.hypot(x, y), x / math.hypot(x, y)
        social_force.walk_by_forces(people, directions, np.empty((0, 5)), walls, model, dt)
        resolve_overlaps(people, starts, np.empty((0, 5)), walls, dt)
        for i in range(count):
            people[i, at.VX] = (people[i, at.X] - starts[i, 0]) / dt
            people[i, at.VY] = (people[i, at.Y] - starts[i, 1]) / dt
            if period >= first:
                total += people[i, at.VX] * directions[i, 0] + people[i, at.VY] * directions[i, 1]
    return total / (count * (periods - first))


def test_speed_falls_with_density_as_measured():
    """Weidmann, "Transporttechnik der Fussgaenger" (1993): v = 1.34 (1 - exp(-1.913 (1 / density - 1 / 5.4))) [m/s]."""
    inner, outer, radius = 4.0, 6.5, 0.2
    angles = np.linspace(0.0, 2.0 * math.pi, 97)
    rings = [size * np.column_stack([np.cos(angles), np.sin(angles)]) for size in (inner, outer)]
    segments = np.vstack([np.column_stack([ring[:-1], ring[1:]]) for ring in rings])
    walls = list_walls(segments, np.empty((0, 3)), (-7.0, -7.0, 7.0, 7.0), radius)
    spots = [
        (size * math.cos(angle), size * math.sin(angle))
        for size in np.arange(inner + radius + 0.02, outer - radius, 2.0 * radius + 0.01)
        for angle in np.linspace(0.0, 2.0 * math.pi, int(2.0 * math.pi * size / 0.41), endpoint=False)
    ]
    speeds = []
    for density in (0.5, 1.5, 2.5, 4.0):
        count = round(density * math.pi * (outer**2 - inner**2))
        people = np.zeros((count, at.PERSON_SIZE))
        people[:, [at.X, at.Y]] = np.array(spots)[np.linspace(0, len(spots) - 1, count).astype(int)]
        people[:, at.RADIUS], people[:, at.SPEED] = radius, 1.34
        speeds.append(mean_speed(people, walls, SocialForce(), 800, 400, 0.05))
        measured = 1.34 * (1.0 - math.exp(-1.913 * (1.0 / density - 1.0 / 5.4)))
        assert speeds[-1] == pytest.approx(measured, abs=0.15), density
    assert np.all(np.diff(speeds) < -0.1)

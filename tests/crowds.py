import numpy as np
from numba import njit

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.geometry.clearance import clearance
from lidarnaut.envs.simulation.crowd import Crowd, People
from lidarnaut.envs.simulation.crowd import person_row as at
from lidarnaut.envs.simulation.crowd.step import step_people
from lidarnaut.envs.simulation.records import ROW
from tests.rooms import make_room

PERIOD = 0.1
HALL = make_room(-6, -6, 6, 6)
CORRIDOR = make_room(-10, -1.75, 10, 1.75)
DOORWAY = make_room(-6, -4, 6, 4, [(0, -4, 0, -0.5), (0, 0.5, 0, 4)], spawn=Pose2D(-3.0, 0.0, 0.0))
CYLINDERS = make_room(
    -6, -6, 6, 6, circles=[(x + 0.3 * (y % 2), y, 0.075) for x in np.arange(-5, 6, 1.5) for y in np.arange(-5, 6, 1.3)]
)
SCENES = {
    "hall": (HALL, Crowd(number=20)),
    "corridor": (CORRIDOR, Crowd(number=20, flow="along")),
    "doorway": (DOORWAY, Crowd(number=10, flow="along")),
    "cylinders": (CYLINDERS, Crowd(number=20)),
}


def robots_at_poses(*poses, radius=0.3):
    rows = np.zeros(len(poses), ROW)
    rows["x"], rows["y"], rows["theta"], rows["v"] = np.transpose(poses)
    rows["period"], rows["radius"] = PERIOD, radius
    return rows


FAR_AWAY = (1000.0, 1000.0, 0.0, 0.0)
NO_ROBOTS = np.empty((0, 5))


def people_at(positions, velocities=0.0, kinds=at.ATTENTIVE):
    """Rows of people with a radius of 0.3 m and a desired speed of 1 m/s."""
    people = np.zeros((len(positions), at.PERSON_SIZE))
    people[:, [at.X, at.Y]], people[:, [at.VX, at.VY]] = positions, velocities
    people[:, at.RADIUS], people[:, at.SPEED], people[:, at.KIND] = 0.3, 1.0, kinds
    return people


def begin(world, crowd, seed=0, poses=(), radius=0.3):
    people = People(crowd)
    people.reset(world, [Pose2D(*pose) for pose in poses], radius, np.random.default_rng(seed))
    return people


def walk(people, periods, robots=None):
    """Let people walk; return their rows after each period, shape (periods, n, PERSON_SIZE)."""
    robots = robots_at_poses(FAR_AWAY) if robots is None else robots
    rows = []
    for _ in range(periods):
        step_people(*people.arrays, robots)
        rows.append(people.rows.copy())
    return np.array(rows)


@njit
def watch(people, points, fields, setup, robots, segments, circles, periods):
    """Let people walk; return maximum overlap between people and with walls [m], and longest slow time [s]."""
    overlap, in_wall, slow = -np.inf, -np.inf, 0.0
    for _ in range(periods):
        step_people(people, points, fields, setup, robots)
        for i in range(people.shape[0]):
            x, y, radius = people[i, at.X], people[i, at.Y], people[i, at.RADIUS]
            in_wall = max(in_wall, radius - clearance(x, y, segments, circles))
            slow = max(slow, people[i, at.SLOW])
            for j in range(i):
                apart = np.hypot(x - people[j, at.X], y - people[j, at.Y])
                overlap = max(overlap, radius + people[j, at.RADIUS] - apart)
    return overlap, in_wall, slow

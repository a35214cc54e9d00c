"""What keeps a body on its side of walls."""

import math

import numpy as np

from envs.geometry import Pose2D
from envs.geometry.clearance import clearance
from envs.simulation import Twist
from envs.simulation.crowd.records import KIND, STANDING, X, Y
from envs.simulation.kinematic import Obstacles, advance
from envs.simulation.records import STATE_SIZE, robot_record
from envs.worlds import FixedRoute
from tests.rooms import BURGER, begin, square_room

PERSON = FixedRoute(0.25, np.array([[-3.0, 0.0], [-3.0, 1.0]]), 0.5)


def stand(simulator, x, y):
    """Make the person stand somewhere."""
    simulator.crowd.rows[0, [KIND, X, Y]] = STANDING, x, y


def test_a_robot_gets_out_between_a_person_and_a_wall():
    """Wedged, it can drive along the wall, but neither into it nor farther into the person."""
    wall = [[BURGER.radius + 1e-3, -5.0, BURGER.radius + 1e-3, 5.0]]
    for heading, gets_out in ((0.5 * math.pi, True), (0.0, False), (math.pi, False)):
        world = square_room(6.0, segments=wall, people=[PERSON])
        simulator = begin("kinematic", BURGER, world, Pose2D(0.0, 0.0, heading))
        stand(simulator, -(BURGER.radius + 0.25) + 0.03, -0.001)  # 3 cm deep in the footprint
        touched = [simulator.step([Twist(0.2, 0.0)])[0].bumper for _ in range(50)]
        pose = simulator.states[0].pose
        assert touched[0]
        assert (math.hypot(pose.x, pose.y) > 0.5) == gets_out
        assert clearance(pose.x, pose.y, world.segments, world.circles) > BURGER.radius - 1e-5
        assert touched[-1] != gets_out


def test_walls_farther_than_a_robot_drives_in_a_period_stop_one_that_is_pushed():
    """Here at 3.5 m/s for 0.1 s, in steps that are shorter than half the footprint's radius."""
    wall, reach = 0.32, BURGER.radius + 0.25
    segments, state = np.array([[wall, -5.0, wall, 5.0]]), np.zeros(STATE_SIZE)
    before, after = np.array([[-reach, 0.0, 0.25]]), np.array([[-reach + 0.35, 0.0, 0.25]])
    command = normals = (0.0, 0.0)
    touched, hits = advance(state, command, normals, robot_record(BURGER, 0.1), Obstacles(segments, before, after))
    assert touched
    assert hits.tolist() == [True]
    assert wall - BURGER.radius - 0.06 < state[0] <= wall - BURGER.radius + 1e-5

import math

import numpy as np
import pytest

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.geometry.clearance import clearance
from lidarnaut.envs.robots import ROBOT_NAMES, load_robot
from lidarnaut.envs.simulation import Twist, make_simulator
from lidarnaut.envs.worlds import FixedRoute, load_world
from tests.rooms import begin, square_room, tilt_of, without_slip

WALL = 2.0
WALLED = square_room(8.0, segments=[[WALL, -8.0, WALL, 8.0]])


def farthest(robot, pose):
    x, y, _ = robot.body.center
    center = pose.transform(np.array([[x, y]]))[0, 0]
    if robot.body.size is None:
        return center + robot.body.radius
    c, s = abs(math.cos(pose.theta)), abs(math.sin(pose.theta))
    return center + 0.5 * (c * robot.body.size[0] + s * robot.body.size[1])


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_a_thin_wall_stops_the_robot(physics, name):
    robot = load_robot(name)
    one_substep = robot.max_v * robot.drive.wheel_radius / robot.odometry.wheel_radius / 60
    for heading, sign in ((0.0, 1), (0.7, 1), (math.pi, -1), (math.pi - 0.3, -1)):
        simulator = begin(physics, robot, WALLED, Pose2D(WALL - robot.radius - 1.4, 0.0, heading))
        touched, reached = [], []
        for _ in range(40 + math.ceil(10 * (2.0 / robot.max_v + robot.max_v / robot.max_acc_v))):
            reading = simulator.step([Twist(sign * robot.max_v, 0.0)])[0]
            pose = simulator.states[0].pose
            touched.append(reading.bumper)
            reached.append(farthest(robot, pose))
            if physics == "kinematic":
                free = clearance(*pose[:2], WALLED.segments, WALLED.circles)
                assert free > robot.radius - 1e-5
            else:
                assert reached[-1] < WALL + 0.001 + one_substep
                assert tilt_of(simulator) < math.radians(10)
        assert sum(touched) > 10
        first = touched.index(True)
        if heading in (0.0, math.pi):
            assert np.ptp(reached[first + 5 : first + 15]) < 0.01, "head-on, the robot has to come to rest"


def test_a_person_stops_at_a_robot_and_walks_on_when_it_has_left(physics):
    robot = load_robot("turtlebot3_waffle_pi")
    path = np.array([[1.5, 0.03], [-3.0, 0.03], [-3.0, 3.0], [1.5, 3.0]])
    person = FixedRoute(radius=0.25, waypoints=path, speed=0.8)
    simulator = begin(physics, robot, square_room(5.0, people=[person]), Pose2D(0.0, 0.0, math.pi / 2))
    touched = [simulator.step([Twist(0.0, 0.0)])[0].bumper for _ in range(40)]
    assert touched[-1]
    assert not touched[0]
    assert math.hypot(*simulator.states[0].pose[:2]) < 0.01, "nobody pushes a robot"
    (x, y, vx, vy, radius), (contact,) = simulator.people[0], simulator.contacts
    assert robot.radius + radius <= math.hypot(x, y) < robot.radius + radius + 0.05
    assert (vx, vy) == (0.0, 0.0)
    assert (contact.kind, contact.by) == ("person", "other")
    for _ in range(60):
        simulator.step([Twist(robot.max_v, 0.0)])
    assert simulator.people[0, 0] < -0.5


@pytest.mark.parametrize("name", ["create3", "turtlebot3_waffle_pi", "raspimouse"])
def test_a_wall_of_many_pieces_is_smooth(physics, name):
    """Robots glide along the wall at a shallow angle; round robots keep their heading, square robots may turn."""
    robot = without_slip(load_robot(name))
    world = square_room(5.0, segments=[[x, 1.0, x + 0.05, 1.0] for x in np.arange(-4.0, 4.01, 0.05)])
    simulator = begin(physics, robot, world, Pose2D(-3.0, 1.0 - robot.radius - 0.01, 0.25))
    seconds = 3.0 / robot.max_v
    touched = [simulator.step([Twist(robot.max_v, 0.0)])[0].bumper for _ in range(round(10 * seconds))]
    assert np.mean(touched) > 0.5
    x, y, theta = simulator.states[0].pose
    forward = robot.drive.wheel_radius / robot.odometry.wheel_radius
    assert 0.9 * math.cos(0.25) * 3.0 * forward < x + 3.0 < 1.01 * 3.0 * forward
    assert 0.0 < y < 1.0
    if robot.body.radius is not None:
        assert theta == pytest.approx(0.25, abs=0.05)


@pytest.mark.parametrize("name", ["raspimouse", "mpo_500", "turtlebot3_waffle_pi"])
def test_a_robot_that_a_wall_keeps_from_turning_is_no_faster_than_it_can_drive(physics, name):
    """Against a wall at all angles, forward and backward, while turning either way."""
    robot = load_robot(name)
    world, wall = (load_world("explorebench_loop"), 9.925) if "waffle" in name else (WALLED, WALL)
    simulator = make_simulator(physics, robot, 0.1)
    limit = 1.05 * robot.max_v * robot.drive.wheel_radius / robot.odometry.wheel_radius
    contacts = 0
    for heading in np.arange(8) * math.pi / 4:
        for v, w in ((1.0, 0.5), (1.0, -0.15), (-1.0, 0.5), (-1.0, -0.15)):
            simulator.reset(world, [Pose2D(wall - robot.radius - 0.03, 0.0, heading)], [np.random.default_rng(0)])
            touched = False
            for _ in range(60):
                before = simulator.states[0].pose
                touched |= simulator.step([Twist(v * robot.max_v, w * robot.max_w)])[0].bumper
                pose = simulator.states[0].pose
                assert not touched or math.dist(before[:2], pose[:2]) < limit * 0.1
                assert pose.x < wall
            contacts += touched
    assert contacts > 8

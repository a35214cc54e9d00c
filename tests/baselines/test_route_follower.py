"""Route follower: speeds of the plan, commands within the robot's limits, distances to the planned route."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from lidarnaut.baselines.reactive import RouteFollower
from lidarnaut.baselines.route_plan import RoutePlan, yaw_rate_for
from lidarnaut.envs.geometry import Pose2D, wrap_angle
from lidarnaut.envs.navigation import PathFollower
from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.simulation import Twist, make_simulator
from lidarnaut.envs.tasks.route import END, SPACING, Progress, Route
from tests.rooms import ORIGIN, square_room

MPO = load_robot("mpo_500")
ARC = np.linspace(0.0, 0.5 * math.pi, 33)
BEND = np.concatenate([[[0.0, 0.0]], np.column_stack([4.0 + np.sin(ARC), 1.0 - np.cos(ARC)]), [[5.0, 5.0]]])
"""Four metres straight, an arc of 1 m radius to the left, and four metres straight."""


def exact(along):
    """Return the pose on the bend at an arc length."""
    turn = min(max(along - 4.0, 0.0), 0.5 * math.pi)
    rest = max(along - 4.0 - 0.5 * math.pi, 0.0)
    return Pose2D(min(along, 4.0) + math.sin(turn), 1.0 - math.cos(turn) + rest, turn)


def drive(corners, robot=MPO, *, hz=17.0, start=ORIGIN, circles=(), physics="kinematic", noise=0.0):
    """Follow a route in a large room; return true poses, planned poses and the number of periods with contacts."""
    route, period, rng = Route.of(corners), 1.0 / hz, np.random.default_rng(0)
    simulator = make_simulator(physics, robot, period)
    reading = simulator.reset(square_room(15.0, circles=circles), [start], [np.random.default_rng(1)])[0]
    follower, progress, poses, planned, contacts = RouteFollower(), Progress(route), [start], [ORIGIN], 0
    follower.reset(robot, period, rng)
    follower.set_route(route)
    steps_left = round((30.0 + 2.0 * route.length / robot.max_v) / period)
    while progress.update(simulator.states[0].pose)[0] < route.length - END and len(poses) < steps_left:
        x, y, theta = simulator.states[0].pose
        estimated = Pose2D(x + noise * rng.normal(), y + noise * rng.normal(), theta + noise * rng.normal())
        reading = simulator.step([follower.act(reading, SimpleNamespace(pose=estimated))])[0]
        contacts += reading.bumper
        poses.append(simulator.states[0].pose)
        planned.append(route.at(follower.along))
    simulator.close()
    return np.array(poses), np.array(planned), contacts


@pytest.mark.parametrize("physics", ["kinematic", "bullet"])
def test_a_robot_with_inertia_follows_a_bend_within_3_degrees_and_15_mm(physics):
    poses, planned, contacts = drive(BEND, physics=physics)
    along = np.linspace(0.0, 8.0 + 0.5 * math.pi, 9600)
    route = np.array([exact(s) for s in along])
    nearest = [int(np.argmin(np.hypot(*(route[:, :2] - pose[:2]).T))) for pose in poses]
    assert np.hypot(*(route[nearest, :2] - poses[:, :2]).T).max() < 0.015
    assert abs(np.degrees(wrap_angle(poses[:, 2] - route[nearest, 2]))).max() < 2.8
    assert np.hypot(*(planned - poses)[:, :2].T).max() < 0.025
    assert abs(np.degrees(wrap_angle(poses[:, 2] - planned[:, 2]))).max() < 2.8
    assert contacts == 0
    # Slow where the arc begins, and at full speed on the straight before.
    speeds = 17.0 * np.hypot(*np.diff(poses[:, :2], axis=0).T)
    at = along[nearest][1:]
    assert speeds[(at > 2.0) & (at < 2.5)].max() == pytest.approx(0.8, abs=0.03)
    assert speeds[abs(at - 4.0) < 0.1].max() < 0.6


def test_the_plan_keeps_within_the_accelerations_of_the_robot():
    plan = RoutePlan(Route.of(BEND), MPO)
    along = np.arange(0.0, 8.0 + 0.5 * math.pi, SPACING)
    v = np.array([plan.speed(s) for s in along])
    braking = -np.gradient(v**2, along) / 2.0
    assert braking.max() <= MPO.max_acc_v * 1.01
    curvature = np.gradient(np.unwrap([plan.path.at(s).theta for s in along]), along)
    assert (v * abs(curvature)).max() < MPO.max_w
    assert (v**2 * abs(np.gradient(curvature, along))).max() < MPO.max_acc_w
    assert v.max() == pytest.approx(MPO.max_v)
    # A robot with much higher accelerations need not slow down.
    quick = RoutePlan(Route.of(BEND), load_robot("turtlebot3_burger"))
    assert min(quick.speed(s) for s in along) == pytest.approx(load_robot("turtlebot3_burger").max_v)


@pytest.mark.parametrize("period", [1 / 17, 0.2, 1.0])
@pytest.mark.parametrize("turn", [-0.02, 0.0, 0.001, 0.04])
def test_a_commanded_yaw_rate_turns_the_robot_by_the_angle(period, turn):
    w = before = 0.05
    command, turned, dt = yaw_rate_for(turn, before, 1.0, period), 0.0, period / 20_000
    for _ in range(20_000):
        change = float(np.clip(command - w, -dt, dt))
        turned += (w + 0.5 * change) * dt
        w += change
    # If the angle is out of reach, the yaw rate changes as fast as possible.
    reach = 0.5 * period**2
    assert turned == pytest.approx(np.clip(turn, before * period - reach, before * period + reach), abs=1e-6)


@pytest.mark.parametrize("start", [Pose2D(0.0, 0.04, -0.2), Pose2D(0.0, -0.03, 0.25), Pose2D(0.0, 0.2, 0.0)])
def test_the_robot_returns_to_the_route(start):
    poses, _, _ = drive([[0.0, 0.0], [6.0, 0.0]], start=start, noise=0.001)
    assert abs(poses[-40:, 1]).max() < 0.01
    assert abs(poses[-40:, 2]).max() < math.radians(1.5)


@pytest.mark.parametrize("hz", [5.0, 17.0])
@pytest.mark.parametrize("name", ["turtlebot3_burger", "jackal", "create3"])
def test_robots_follow_sharp_corners_and_turns_back(name, hz):
    path = [[0.0, 0.0], [2.0, 0.0], [2.0, 1.5], [0.5, 2.0], [1.7, 1.6]]
    poses, _, contacts = drive(path, load_robot(name), hz=hz, noise=0.001)
    route = Route.of(path)
    assert math.hypot(*(poses[-1, :2] - path[-1])) < 0.2
    assert max(np.hypot(*(route.points - pose[:2]).T).min() for pose in poses) < 0.25
    assert contacts == 0


@pytest.mark.parametrize(
    ("name", "left", "is_free"), [("mpo_500", 0.0, False), ("mpo_500", 0.6, False), ("create3", 0.3, True)]
)
def test_the_robot_touches_nothing_that_stands_on_the_route_and_passes_what_is_beside_it(name, left, is_free):
    poses, _, contacts = drive([[0.0, 0.0], [8.0, 0.0]], load_robot(name), circles=[(4.0, left, 0.1)])
    assert contacts == 0
    assert (poses[-1, 0] > 7.8) == is_free


def test_a_stop_of_pure_pursuit_is_commanded_at_once(monkeypatch):
    robot, commands = load_robot("create3"), []
    simulator, follower = make_simulator("kinematic", robot, 0.1), RouteFollower()
    reading = simulator.reset(square_room(15.0), [ORIGIN], [np.random.default_rng(0)])[0]
    follower.reset(robot, 0.1, np.random.default_rng(0))
    follower.set_route(Route.of([[0.0, 0.0], [8.0, 0.0]]))
    for k in range(30):
        if k == 25:
            monkeypatch.setattr(PathFollower, "command", lambda *_: Twist(0.0, 0.0))
        commands.append(follower.act(reading, SimpleNamespace(pose=simulator.states[0].pose)))
        reading = simulator.step(commands[-1:])[0]
    assert commands[24].v > 0.4
    assert commands[25:] == [Twist(0.0, 0.0)] * 5
    # The plan waits for the robot, which brakes.
    assert abs(follower.along - simulator.states[0].pose.x) < SPACING

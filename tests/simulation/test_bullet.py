import itertools
import math
import pickle
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import pytest

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.geometry.raycast import Beams, cast_rays
from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.simulation import Twist, make_simulator
from lidarnaut.envs.worlds import WORLD_NAMES, load_world
from tests.rooms import BURGER, ORIGIN, begin, make_room, square_room, tilt_of

pytest.importorskip("pybullet", reason="PyBullet is not installed")

from lidarnaut.envs.simulation import bullet_world
from lidarnaut.envs.simulation.bullet_world import BulletClient, NearbyWalls, build_meshes, outlines

ROOT = Path(__file__).parents[2]
BEAMS, POSES, REACH = 360, 25, 12.0
TOLERANCE = 0.002
GRAZED = 1e-3
"""Maximum distance of a grazing beam from a corner [m]: PyBullet's rays see triangles slightly too large."""


def test_worlds_may_have_more_walls_than_fit_into_one_mesh():
    """A floor of 200 m x 60 m has 47,000 walls, circles included; the last one is as solid as the first."""
    xs = np.linspace(-9.0, 9.0, 35_000)
    far = np.column_stack([xs, np.full_like(xs, 9.0), xs, np.full_like(xs, 9.1)])
    simulator = begin("bullet", BURGER, square_room(10.0, [*far, [0.3, -1.0, 0.3, 1.0]]), ORIGIN)
    for _ in range(30):
        reading = simulator.step([Twist(0.2, 0.0)])[0]
    assert reading.bumper
    assert simulator.states[0].pose.x < 0.3


def test_pybullet_is_imported_late_and_silently():
    code = """
import sys
import numpy as np
from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.simulation import Twist, make_simulator
from lidarnaut.envs.worlds import load_world
robot = load_robot("turtlebot3_burger")
make_simulator("kinematic", robot, 0.1)
assert "pybullet" not in sys.modules
world = load_world("turtlebot3_world")
simulator = make_simulator("bullet", robot, 0.1)
simulator.reset(world, [world.spawns[0]], [np.random.default_rng(0)])
simulator.step([Twist(0.1, 0.0)])
simulator.close()
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=False)
    assert run.returncode == 0, run.stderr
    assert "pybullet" not in (run.stdout + run.stderr).lower()


def test_it_can_be_pickled_before_the_first_reset_and_closed_twice():
    simulator = pickle.loads(pickle.dumps(make_simulator("bullet", BURGER, 0.1)))
    simulator.close()
    for _ in range(2):
        simulator.reset(square_room(3.0), [ORIGIN], [np.random.default_rng(0)])
        simulator.step([Twist(0.1, 0.0)])
        simulator.close()
        simulator.close()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_ever_new_worlds_do_not_fill_the_memory():
    rng = np.random.default_rng(0)
    simulator = make_simulator("bullet", BURGER, 0.1)

    def megabytes_after(num_worlds):
        for _ in range(num_worlds):
            corners = rng.uniform(1.0, 9.0, (2000, 2))
            segments = np.hstack([corners, corners + rng.uniform(-0.3, 0.3, corners.shape)])
            simulator.reset(square_room(10.0, segments), [ORIGIN], [rng])
        return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6

    before = megabytes_after(4)
    assert megabytes_after(12) - before < 8.0, "2 MB are lost with every such world when lists are not reused"


@pytest.fixture
def many(monkeypatch):
    monkeypatch.setattr(bullet_world, "_MAX_RECTANGLES", 0)


def corridor(length):
    """Corridor of 1 m along x, of wall pieces of 0.1 m, closed at both ends."""
    sides = [[x, y, x + 0.1, y] for y in (-0.5, 0.5) for x in np.arange(0.0, length, 0.1)]
    ends = [[x, -0.5, x, 0.5] for x in (0.0, length)]
    bodies = {"segments": np.array(sides + ends), "circles": np.array([[length - 1.0, 0.4, 0.1]])}
    return replace(make_room(0.0, -0.5, length, 0.5, spawn=Pose2D(0.5, 0.0, 0.0)), **bodies)


def drive(simulator, world, commands, seed=0):
    simulator.reset(world, [world.spawns[0]], [np.random.default_rng(seed)])
    readings = [simulator.step([command])[0] for command in commands]
    return simulator.states[0].pose, readings[-1]


def test_a_robot_far_from_its_start_is_stopped_by_walls(many):
    robot = load_robot("create3")
    simulator = make_simulator("bullet", robot, 0.2)
    length = 14.0
    pose, reading = drive(simulator, corridor(length), [Twist(robot.max_v, 0.0)] * 300)
    assert length / 2 < pose.x < length - robot.radius + 0.02
    assert abs(pose.y) < 0.5 - robot.radius + 0.02
    assert reading.bumper


def test_an_episode_does_not_depend_on_the_one_before(many):
    world, rng = load_world("turtlebot3_house"), np.random.default_rng(1)
    commands = [Twist(BURGER.max_v, float(w)) for w in rng.uniform(-1.0, 1.0, 60).repeat(5)]
    first, again = (make_simulator("bullet", BURGER, 0.2) for _ in range(2))
    drive(again, world, commands[::-1], seed=5)
    poses = [drive(simulator, world, commands)[0] for simulator in (first, again, again)]
    assert poses[0] == poses[1] == poses[2]


def test_what_is_near_is_there_and_what_is_far_is_not(many):
    """Along a drive of 30 m, all walls within range are present, and the meshes of old walls are gone."""
    shapes, client, numbers = {}, MagicMock(), itertools.count()
    client.createCollisionShape.side_effect = lambda _, vertices, **__: shapes.setdefault(next(numbers), vertices)
    client.createMultiBody.side_effect = lambda *_: max(shapes)
    client.removeBody.side_effect = shapes.pop
    world, reach = corridor(30.0), 0.7
    walls = NearbyWalls(client, world, reach)
    for x in np.arange(0.5, 29.5, 0.1):
        walls.follow(np.array([[x, 0.0]]))
        (built,) = shapes.values()
        starts = {tuple(np.round(point[:2], 3)) for point in built}
        for x0, y0, x1, _ in world.segments:
            if math.hypot(max(x0 - x, x - x1, 0.0), y0) < reach:
                assert (round(x0, 3), round(y0, 3)) in starts
        assert np.abs(np.array(built)[:, 0] - x).max() < 5.0


@pytest.mark.parametrize("name", WORLD_NAMES[::4])
def test_ranges_agree_within_two_millimetres(name):
    world = load_world(name)
    bullet = BulletClient()
    (mesh,) = build_meshes(bullet, outlines(world, sagitta=1e-5), world.height)
    bullet.createMultiBody(0.0, mesh)
    corners = np.vstack([world.segments[:, :2], world.segments[:, 2:]])
    rng = np.random.default_rng(0)
    ranges, grazing = np.empty(BEAMS), 0
    for _ in range(POSES):
        x, y = rng.uniform(world.bounds[:2], world.bounds[2:])
        heading, increment = rng.uniform(-math.pi, math.pi), 2 * math.pi / BEAMS
        cast_rays(x, y, heading, Beams(0.0, increment, REACH), world.segments, world.circles, ranges)
        angles = heading + increment * np.arange(BEAMS)
        directions = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(BEAMS)])
        starts = np.tile([x, y, 0.5 * world.height], (BEAMS, 1))
        hits = bullet.rayTestBatch(starts.tolist(), (starts + REACH * directions).tolist())
        theirs = np.array([fraction * REACH if body >= 0 else np.inf for body, _, fraction, *_ in hits])
        for beam in np.flatnonzero(~np.isclose(ranges, theirs, rtol=0.0, atol=TOLERANCE)):
            point = np.array([x, y]) + min(ranges[beam], theirs[beam]) * directions[beam, :2]
            assert np.hypot(*(corners - point).T).min() < GRAZED, f"{ranges[beam]} m against {theirs[beam]} m"
            grazing += 1
    assert grazing <= 0.001 * BEAMS * POSES


def corner(robot):
    """Two thin walls, 10 m long, that meet at 30 degrees ahead of a robot at the origin."""
    tip, angle = (robot.radius + 0.03) / math.sin(math.radians(15)), math.radians(15)
    x, y = tip - 10.0 * math.cos(angle), 10.0 * math.sin(angle)
    return square_room(12.0, segments=[[tip, 0.0, x, y], [tip, 0.0, x, -y]])


def test_a_robot_that_drives_into_a_corner_stays_in_front_of_it_and_gets_out_again():
    robot = load_robot("mpo_500")
    simulator, poses = make_simulator("bullet", robot, 0.05), []
    for _ in range(2):  # episodes are independent of previous penetrations in the engine
        simulator.reset(corner(robot), [ORIGIN], [np.random.default_rng(0)])
        touched = [simulator.step([Twist(robot.max_v, 0.0)])[0].bumper for _ in range(240)]
        assert np.mean(touched[80:]) > 0.9
        pressed = simulator.states[0].pose
        assert 0.2 < pressed.x < 0.8
        for _ in range(200):
            simulator.step([Twist(-robot.max_v, 0.0)])
        poses.append(simulator.states[0].pose)
        assert poses[-1].x < pressed.x - 1.0
    assert poses[0] == poses[1]


def test_a_robot_that_accelerates_too_fast_for_its_weight_drives_on_level():
    robot = load_robot("turtlebot3_burger")
    drive = replace(robot.drive, max_torque=10.0 * robot.drive.max_torque)
    simulator = begin("bullet", replace(robot, max_v=3.0, max_acc_v=20.0, drive=drive), square_room(12.0), ORIGIN)
    for _ in range(20):
        reading = simulator.step([Twist(3.0, 0.0)])[0]
        assert tilt_of(simulator) < math.radians(25)
        assert not reading.bumper
    assert simulator.states[0].pose.x > 1.0


def test_a_body_that_is_larger_than_its_footprint_gets_free():
    """A wall overlaps the body from the start, and must not block any way out."""
    robot = replace(load_robot("create3"), radius=0.05)
    simulator = begin("bullet", robot, square_room(3.0, segments=[[0.06, -2.0, 0.06, 2.0]]), Pose2D(0.0, 0.0, math.pi))
    for _ in range(40):
        simulator.step([Twist(0.3, 0.0)])
    assert simulator.states[0].pose.x < -0.5

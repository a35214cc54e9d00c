"""Constant memory in long runs, and robots that drive into walls at full speed."""

import math
import os
from dataclasses import replace

import gymnasium
import numpy as np
import pytest

from lidarnaut.envs.arguments import choose_robot
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.robots import ROBOT_NAMES, load_robot
from lidarnaut.envs.simulation import PHYSICS, Twist, make_simulator
from lidarnaut.envs.worlds import WORLD_NAMES, World, explorable_area, load_world

NUM_ENVS, SAMPLES, GROWTH = 16, 40, 1.05
"""Number of sub-environments, number of memory samples, and maximum growth factor in the second half of a run."""
PERIOD, BURST, STARTS = 0.2, 8, 10
"""Control period [s], control periods with the same command, and random starts in a world."""
TOLERANCE, SLACK = 1.1, 0.02
"""Maximum speed ratio explained by wheel slip, and maximum push-out distance of a wall per period [m]."""
ANGLES = (15, 30, 45, 60, 75)
"""Angles between a robot's heading and the wall ahead [deg]."""


def resident():
    """Resident memory of this process [MiB]."""
    with open("/proc/self/statm", encoding="ascii") as file:
        return round(int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20)


@pytest.mark.slow
@pytest.mark.parametrize("slam", ["tinyslam", "hector"])
def test_memory_of_a_long_run_does_not_grow(slam, row):
    env = gymnasium.make_vec(
        "lidarnaut:lidarnaut/Explore-v0", NUM_ENVS, world="rooms", world_size=(8.0, 8.0), physics="kinematic",
        slam=slam, control_hz=5.0, time_limit=20.0, num_workers=1,
    )  # fmt: skip
    rng, rounds, samples = np.random.default_rng(0), 1_000_000 // NUM_ENVS, []
    env.reset(seed=0)
    for k in range(rounds):
        env.step(rng.uniform((-0.2, -1.0), 1.0, (NUM_ENVS, 2)).astype(np.float32))
        if k % (rounds // SAMPLES) == 0:
            samples.append(resident())
    env.close()
    second, last = max(samples[SAMPLES // 4 : SAMPLES // 2]), max(samples[-SAMPLES // 4 :])
    row("memory [MiB]", SLAM=slam, steps=rounds * NUM_ENVS, second_quarter=second, last_quarter=last)
    assert 50 < last <= GROWTH * second


@pytest.mark.parametrize("physics", PHYSICS)
def test_no_robot_crosses_a_wall_or_is_faster_than_its_limits(physics, size, row):
    counts = np.zeros(4, dtype=int)
    for world in size(("turtlebot3_world", "pimouse_arena"), WORLD_NAMES):
        counts += drive(world, physics, size(500, 1000))
    periods, touching, through, fast = counts.tolist()
    row("full speed", physics=physics, control_periods=periods, in_contact=touching, through=through, too_fast=fast)
    assert touching > 0.02 * periods
    assert (through, fast) == (0, 0)


def drive(world_name, physics, steps):
    """Drive at full speed in random directions; count control periods, contacts, crossed walls and speeding.

    Worlds are driven without moving obstacles, which push robots beyond their speed limits.
    """
    world, robot = replace(load_world(world_name), people=()), choose_robot(None, world_name)
    rng = np.random.default_rng([0, len(world.segments)])
    area = explorable_area(world, robot, 0.005 if robot.radius < 0.1 else 0.05)  # for corridors of 0.18 m
    simulator = make_simulator(physics, robot, PERIOD)
    farthest = TOLERANCE * robot.max_v * robot.drive.wheel_radius / robot.odometry.wheel_radius * PERIOD + SLACK
    counts = np.zeros(4, dtype=int)
    for _ in range(STARTS):
        pose = area.draw_pose(rng)
        simulator.reset(world, [pose], [rng])
        for k in range(math.ceil(steps / STARTS)):
            if k % BURST == 0:
                command = Twist(robot.max_v * rng.choice([-1.0, 1.0]), robot.max_w * rng.choice([-1.0, 0.0, 0.0, 1.0]))
            [reading] = simulator.step([command])
            before, pose = pose, simulator.states[0].pose
            is_too_fast = math.hypot(pose.x - before.x, pose.y - before.y) > farthest
            counts += 1, bool(reading.bumper), crosses(before, pose, world.segments), is_too_fast
    simulator.close()
    return counts


def crosses(before, after, segments):
    """Return True if the line between two positions crosses a segment, shape (n, 4) [m]."""

    def side(a, b, p):
        """Return the side of the line from a to b with the point p, as a sign."""
        ab, ap = b - a, p - a
        return np.sign(ab[..., 0] * ap[..., 1] - ab[..., 1] * ap[..., 0])

    a, b, c, d = np.array(before[:2]), np.array(after[:2]), segments[:, :2], segments[:, 2:]
    return bool(((side(a, b, c) * side(a, b, d) < 0.0) & (side(c, d, a) * side(c, d, b) < 0.0)).any())


def test_a_step_through_a_wall_is_seen():
    wall = np.array([[1.0, -1.0, 1.0, 1.0]])
    start = Pose2D(0.5, 0.0, 0.0)
    assert crosses(start, Pose2D(1.5, 0.2, 0.0), wall)
    assert not crosses(start, Pose2D(0.9, 0.2, 0.0), wall)
    assert not crosses(Pose2D(0.5, 1.5, 0.0), Pose2D(1.5, 1.6, 0.0), wall)
    assert not crosses(start, start, wall)


def slide(robot_name, physics, angle):
    """Return the distance along a wall in ten seconds at full speed, heading into it at `angle` [deg] [m]."""
    robot = load_robot(robot_name)
    start = Pose2D(0.0, -robot.radius - 0.01, math.radians(angle))
    wall = np.array([[-20.0, 0.0, 20.0, 0.0]])
    world = World("wall", wall, np.empty((0, 3)), spawns=(start,), bounds=(-20.0, -20.0, 20.0, 0.0))
    simulator = make_simulator(physics, robot, PERIOD)
    simulator.reset(world, [start], [np.random.default_rng(0)])
    for _ in range(round(10.0 / PERIOD)):
        simulator.step([Twist(robot.max_v, 0.0)])
    x = simulator.states[0].pose.x
    simulator.close()
    return x


def test_robots_slide_along_walls(size, row):
    for robot in size(("turtlebot3_burger",), ROBOT_NAMES):
        slides = {a: [slide(robot, physics, a) for physics in ("kinematic", "bullet")] for a in ANGLES}
        cells = {f"{a} deg": " / ".join(f"{x:.2f}" for x in pair) for a, pair in slides.items()}
        row("along a wall [m]: kinematic / bullet", robot=robot, **cells)
        if robot == "turtlebot3_burger":
            assert slides[60][0] == pytest.approx(0.22 * 10.0 * 0.5, rel=0.1)
            assert slides[15][1] == pytest.approx(0.22 * 10.0, rel=0.1)

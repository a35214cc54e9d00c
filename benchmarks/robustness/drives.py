"""Long runs, whose memory must stay as it is, and robots that drive into walls at full speed."""

import math
import os
from dataclasses import replace

import gymnasium
import numpy as np

from envs.arguments import choose_robot
from envs.geometry import Pose2D
from envs.progress import Progress
from envs.robots import ROBOT_NAMES, load_robot
from envs.simulation import Twist, make_simulator
from envs.worlds import World, explorable_area, load_world

from . import Report

SLAMS, NUM_ENVS, SAMPLES = ("tinyslam", "hector"), 16, 40
"""Of the vector environments that take many steps; their sub-environments; how often memory is measured."""
GROWTH = 1.05
"""Memory at the end over that in the middle of a run up to which it counts as flat."""
PERIOD, BURST, STARTS = 0.2, 8, 10
"""Control period [s], control periods with the same command, and random starts in a world with walls."""
TOLERANCE, SLACK = 1.1, 0.02
"""Speed over the robot's greatest that wheel slip explains, and distance beyond it by which a wall may push a robot out
in a control period [m]."""
ANGLES = (15, 30, 45, 60, 75)
"""Between a robot's heading and the wall that it drives into [deg]."""


def take_steps(count: int, seed: int, slams: tuple[str, ...] = SLAMS) -> Report:
    """Take `count` random steps with each SLAM in ever new worlds of 8 m, on this process alone."""
    rows, failures = [], []
    for slam in slams:
        env = gymnasium.make_vec(
            "envs:lidarnaut/Explore-v0", NUM_ENVS, world="rooms", world_size=(8.0, 8.0), physics="kinematic",
            slam=slam, control_hz=5.0, time_limit=20.0, num_workers=1,
        )  # fmt: skip
        rng, rounds, samples, episodes = np.random.default_rng(seed), max(count // NUM_ENVS, SAMPLES), [], 0
        env.reset(seed=seed)
        for k in Progress(range(rounds), desc=f"steps with {slam}", unit="round"):
            actions = rng.uniform((-0.2, -1.0), 1.0, (NUM_ENVS, 2)).astype(np.float32)
            _, _, terminated, truncated, _ = env.step(actions)
            episodes += int(np.count_nonzero(terminated | truncated))
            if k % (rounds // SAMPLES) == 0:
                samples.append(resident())
        env.close()
        quarter = len(samples) // 4
        middle, end = max(samples[quarter : 2 * quarter]), max(samples[-quarter:])
        row = {"SLAM": slam, "steps": rounds * NUM_ENVS, "episodes": episodes}
        rows.append(row | {"memory in the second quarter [MiB]": middle, "in the last quarter [MiB]": end})
        failures += [f"memory grows with {slam}"] * (end > GROWTH * middle)
    return rows, failures


def resident() -> int:
    """Return the resident memory of this process [MiB]."""
    with open("/proc/self/statm", encoding="ascii") as file:
        return round(int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20)


def drive_into_walls(worlds: tuple[str, ...], physics: tuple[str, ...], steps: int, seed: int) -> Report:
    """Drive `steps` control periods in each world at full speed in random directions."""
    rows, failures = [], []
    for one in physics:
        row = dict.fromkeys(("control periods", "in contact", "through a wall", "above the speed"), 0)
        for world in Progress(worlds, desc=f"walls, {one}", unit="drive"):
            found = drive(world, one, steps, seed)
            row = {key: value + found[key] for key, value in row.items()}
            if found["through a wall"] or found["above the speed"]:
                failures.append(f"{world}, {one}: {found}")
        rows.append({"physics": one, "worlds": len(worlds), **row})
    return rows, failures


def drive(world_name: str, physics: str, steps: int, seed: int) -> dict[str, int]:
    """Drive from ten random starts, and count control periods, and those that ended in contact, too far or too fast.

    What pushes robots aside makes them faster than their limits, so that worlds are driven without what moves.
    """
    world = replace(load_world(world_name), movers=())
    robot = choose_robot(None, world_name)
    rng = np.random.default_rng([seed, len(world.segments)])
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
            reading = simulator.step([command])[0]
            before, pose = pose, simulator.states[0].pose
            is_too_fast = math.hypot(pose.x - before.x, pose.y - before.y) > farthest
            counts += 1, bool(reading.bumper), crosses(before, pose, world.segments), is_too_fast
    simulator.close()
    return dict(zip(("control periods", "in contact", "through a wall", "above the speed"), counts.tolist()))


def slide_along_walls(physics: tuple[str, ...]) -> Report:
    """Return how far robots get along a wall at each of `ANGLES`."""
    rows = []
    for robot in ROBOT_NAMES:
        slides = {f"{a} deg": " / ".join(f"{slide(robot, one, a):.2f}" for one in physics) for a in ANGLES}
        rows.append({f"along a wall [m]: {' / '.join(physics)}": robot, **slides})
    return rows, []


def slide(robot_name: str, physics: str, angle: float) -> float:
    """Return how far a robot gets along a wall in ten seconds at full speed, heading into it at an angle [deg] [m]."""
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


def crosses(before: Pose2D, after: Pose2D, segments: np.ndarray) -> bool:
    """Tell whether the line between two positions crosses one of some segments, shape (n, 4) [m]."""
    a, b, c, d = np.array(before[:2]), np.array(after[:2]), segments[:, :2], segments[:, 2:]
    sides = _side(a, b, c) * _side(a, b, d), _side(c, d, a) * _side(c, d, b)
    return bool(((sides[0] < 0.0) & (sides[1] < 0.0)).any())


def _side(a: np.ndarray, b: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return on which side of the line from a to b a point lies: the sign of the cross product."""
    ab, ap = b - a, p - a
    return np.sign(ab[..., 0] * ap[..., 1] - ab[..., 1] * ap[..., 0])

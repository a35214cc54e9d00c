"""Environments and trainings whose steps per second are compared."""

import contextlib
import dataclasses
import importlib
import itertools
import math
from collections.abc import Callable, Iterator
from functools import lru_cache, partial
from importlib.util import find_spec
from typing import Any, NamedTuple

import gymnasium
import numpy as np

import lidarnaut.agents  # noqa: F401  (before torch, whose threads it keeps from spinning)
from lidarnaut.benchmarks.speed.peers.step import step
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.robots import RobotParams, load_robot
from lidarnaut.envs.worlds.world import World, box, edges

ACTION_REPEAT = 10
TRAININGS = "reach_crowd", "rooms_fast", "reach_scans"
"""Configurations of the measured trainings."""
ROLLOUT, BATCH, EPOCHS = 32_768, 512, 4
"""Steps of a rollout, size of a minibatch and passes over a rollout in `reach_scans`."""
DESIGNS = [("bullet", 1, 1), ("kinematic", 1, 1)]
DESIGNS += [("kinematic", num_envs, cores) for cores in (1, 2) for num_envs in (16, 64, 256)]
DESIGNS += [("bullet", 16, 1), ("bullet", 16, 2), ("SubprocVecEnv", 2, 1), ("SubprocVecEnv", 2, 2)]
"""Physics, number of sub-environments, number of cores; `SubprocVecEnv` of stable-baselines3 has kinematic physics."""
SIDE, GAP, FREE_AROUND_SPAWN = 16.0, 0.35, 0.7
"""Inner side length of a hall, and minimum distance of obstacles from each other and from the start pose [m]."""
PACKING = 0.45
"""Share of the floor covered by obstacles if all have maximum size, with half of `GAP` around each; sets this size."""


class Case(NamedTuple):
    """Measured environment or training, in a row and a column of the table."""

    row: str
    column: str
    cores: int
    drive: Callable[[], Iterator[int]]
    """Returns an iterator that steps all sub-environments, and yields the number of steps."""


def designs() -> Iterator[list[Case]]:
    """Yield environments that explore a hall with 50 or 300 obstacles, with TinySLAM or the true pose."""
    for bodies, slam in itertools.product((50, 300), ("tinyslam", "truth")):
        hall = {"world": make_hall(bodies), "robot": benchmark_robot(), "slam": slam, "start": "spawn"}
        explore = partial(step_environment, "Explore-v0", **hall)
        yield [
            Case("{} x {}, cores: {}".format(*design), f"{slam}, {bodies} bodies", design[2], partial(explore, *design))
            for design in DESIGNS
        ]


def decisions() -> Iterator[list[Case]]:
    """Yield environments whose robots drive to the nearest frontier in rooms, with Hector; a step is a decision."""
    decide = partial(step_environment, "ExploreFrontiers-v0", "kinematic", world="rooms", world_size=(20.0, 20.0))
    yield [Case(f"x {num_envs}", "decisions", 1, partial(decide, num_envs)) for num_envs in (1, 16, 64, 256)]


def people() -> Iterator[list[Case]]:
    """Yield vector environments with goals among people."""
    hall = {"world_size": (12.0, 12.0), "observations": ("scan_history", "goal"), "robot": "turtlebot3_burger"}
    reach = partial(step_environment, "ReachCrowd-v0", "kinematic", 64, **hall)
    yield [
        Case(f"people: {number}", f"contact {contact}", 1, partial(reach, people=number, contact=contact))
        for number, contact in itertools.product((0, 10, 30), ("costs", "ends"))
    ]


def trainings() -> Iterator[list[Case]]:
    """Yield whole trainings, rollouts and updates, with a process on each of one or two cores."""
    for name in TRAININGS:
        yield [Case(name, f"cores: {cores}", cores, partial(train, name, cores)) for cores in (1, 2)]


def libraries() -> Iterator[list[Case]]:
    """Yield the training of `reach_scans` by this package and by others, on two cores; sbx if it is installed."""
    kinds = [("stable_baselines3", *kind) for kind in (("DummyVecEnv", 8), ("SubprocVecEnv", 8), ("SubprocVecEnv", 2))]
    kinds += [("sbx", "DummyVecEnv", 8)] if find_spec("sbx") else []
    others = [
        Case(f"{kind} x {number}, {library}", "steps/s", 2, partial(train_by, library, kind, number))
        for library, kind, number in kinds
    ]
    yield [Case("lidarnaut", "steps/s", 2, partial(train, "reach_scans", 2)), *others]


def benchmark_robot(num_beams: int = 360) -> RobotParams:
    """Return a TurtleBot3 Burger with a lidar range of 10 m."""
    robot = load_robot("turtlebot3_burger")
    return dataclasses.replace(robot, lidar=dataclasses.replace(robot.lidar, num_beams=num_beams, range_max=10.0))


@lru_cache(maxsize=2)
def make_hall(num_bodies: int) -> World:
    """Return a square hall with crates, and every tenth body a pillar, at random but reproducible poses."""
    rng = np.random.default_rng(num_bodies)
    largest = math.sqrt(PACKING * SIDE**2 / (math.pi * num_bodies)) - 0.5 * GAP
    placed = np.empty((0, 3))
    while len(placed) < num_bodies:
        radius = rng.uniform(0.6, 1.0) * largest
        x, y = rng.uniform(-0.5 * SIDE + GAP + radius, 0.5 * SIDE - GAP - radius, 2)
        distances = np.hypot(placed[:, 0] - x, placed[:, 1] - y) - placed[:, 2]
        if (distances >= radius + GAP).all() and math.hypot(x, y) >= radius + FREE_AROUND_SPAWN:
            placed = np.vstack([placed, [x, y, radius]])
    walls = [edges(box(0.0, 0.0, SIDE, SIDE))]
    for x, y, radius in np.delete(placed, np.s_[::10], axis=0).tolist():
        # Crates are inscribed in their circle at any yaw.
        diagonal = rng.uniform(math.pi / 8, 3 * math.pi / 8)
        size = 2.0 * radius * math.cos(diagonal), 2.0 * radius * math.sin(diagonal)
        walls.append(edges(box(x, y, *size, float(rng.uniform(-math.pi, math.pi)))))
    pillars, half = np.ascontiguousarray(placed[::10] * (1.0, 1.0, 0.5)), 0.5 * SIDE
    spawns, bounds = (Pose2D(0.0, 0.0, 0.0),), (-half, -half, half, half)
    return World(f"hall_{num_bodies}", np.vstack(walls), pillars, spawns=spawns, bounds=bounds)


def step_environment(id: str, kind: str, num_envs: int, cores: int = 1, **options: Any) -> Iterator[int]:
    """Step an environment of a kind in `DESIGNS`, with random twists or the decision 0; yield the number of steps."""
    id, options["physics"] = f"lidarnaut:lidarnaut/{id}", "bullet" if kind == "bullet" else "kinematic"
    make_single = partial(gymnasium.make, id, **options)
    env: Any
    if kind == "SubprocVecEnv":
        from stable_baselines3.common.vec_env import SubprocVecEnv

        env = SubprocVecEnv([make_single] * num_envs, start_method="spawn")
        env.seed(0)
        env.reset()
    else:
        options |= {"num_workers": cores, "context": "spawn"} if num_envs > 1 else {}  # workers inherit the cores
        env = make_single() if num_envs == 1 else gymnasium.make_vec(id, num_envs, "vector_entry_point", **options)
        env.reset(seed=0)
    actions = np.zeros((1, num_envs), dtype=np.int64)
    if isinstance(env.action_space, gymnasium.spaces.Box):
        twists = np.random.default_rng(0).uniform((0.3, -1.0), 1.0, (500, num_envs, 2))
        actions = np.repeat(twists.astype(np.float32), ACTION_REPEAT, axis=0)
    yield from step(env, actions)


def train(name: str, processes: int) -> Iterator[int]:
    """Train by a configuration; yield the number of steps of each rollout and its updates."""
    from stable_baselines3.common.logger import Logger

    from lidarnaut.agents.config import change, find_configuration, parse_config
    from lidarnaut.agents.distributed import Share, group_of
    from lidarnaut.agents.learning import build
    from lidarnaut.agents.recipes import with_recipe
    from lidarnaut.envs.files import read_mapping

    data, _ = with_recipe(read_mapping(find_configuration(name, "experiment")))
    if "num_worlds" in data["environment"]:  # made during the measurement
        data = change(data, {"environment.num_worlds": 4})
    config: Any = parse_config(data | {"processes": processes, "total_steps": 10**9}, name)
    with contextlib.ExitStack() as held:
        group = held.enter_context(group_of(processes, (config, None, ())))
        prepared, model, _ = build(config, held)
        model.set_logger(Logger(None, []))
        share = Share(model, group)
        while True:
            model.learn(prepared.rollout_steps, share, reset_num_timesteps=False)
            yield prepared.rollout_steps


def train_by(library: str, kind: str, num_envs: int) -> Iterator[int]:
    """Train `reach_scans` by PPO of stable-baselines3 or sbx on its own vector environment.

    Rollout, minibatches and epochs are those of the configuration. Yields the number of steps of each rollout.
    """
    from stable_baselines3.common import vec_env
    from stable_baselines3.common.monitor import Monitor

    is_flat = library == "sbx"  # it takes vectors only

    def make() -> gymnasium.Env:
        parts = ("scan_history", "goal", "motion")
        env = gymnasium.make("lidarnaut:lidarnaut/ReachGoal-v0", observations=parts, physics="kinematic")
        return Monitor(gymnasium.wrappers.FlattenObservation(env) if is_flat else env)

    options: dict[str, Any] = {"start_method": "spawn"} if kind == "SubprocVecEnv" else {}
    env = getattr(vec_env, kind)([make] * num_envs, **options)
    settings = {"n_steps": ROLLOUT // num_envs, "batch_size": BATCH, "n_epochs": EPOCHS, "device": "cpu"}
    model = importlib.import_module(library).PPO("MlpPolicy" if is_flat else "MultiInputPolicy", env, **settings)
    try:
        while True:
            model.learn(ROLLOUT, reset_num_timesteps=False)
            yield ROLLOUT
    finally:
        env.close()

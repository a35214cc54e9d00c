"""Environments and trainings whose steps per second are compared."""

import dataclasses
import itertools
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import gymnasium
import numpy as np

import lidarnaut.agents  # noqa: F401  (before torch, whose threads it keeps from spinning)
from lidarnaut.benchmarks.speed.halls import make_hall
from lidarnaut.envs.robots import RobotParams, load_robot

ACTION_REPEAT, NUM_ACTIONS = 10, 500
TRAININGS = "reach_crowd", "rooms_fast", "reach_scans"
"""Configurations of the measured trainings."""
DESIGNS = [("bullet", 1, 1), ("kinematic", 1, 1)]
DESIGNS += [("kinematic", num_envs, cores) for cores in (1, 2) for num_envs in (16, 64, 256)]
DESIGNS += [("bullet", 16, 1), ("bullet", 16, 2), ("SubprocVecEnv", 2, 1), ("SubprocVecEnv", 2, 2)]
"""Physics, number of sub-environments, number of cores; `SubprocVecEnv` of stable-baselines3 has kinematic physics."""


class Case(NamedTuple):
    """Measured environment or training."""

    row: str
    """Row of the table."""
    column: str
    """Column of the table."""
    cores: int
    """Number of CPU cores."""
    drive: Callable[[], Iterator[int]]
    """Returns an iterator that steps all sub-environments, and yields the number of steps."""


def designs() -> Iterator[list[Case]]:
    """Yield environments that explore a hall with 50 or 300 obstacles, with TinySLAM or the true pose."""
    for bodies, slam in itertools.product((50, 300), ("tinyslam", "truth")):
        options = {"world": make_hall(bodies), "robot": benchmark_robot(), "slam": slam, "start": "spawn"}
        yield [
            Case(
                f"{kind} x {num_envs}, cores: {cores}",
                f"{slam}, {bodies} bodies",
                cores,
                partial(step_environment, "Explore-v0", kind, num_envs, cores, **options),
            )
            for kind, num_envs, cores in DESIGNS
        ]


def decisions() -> Iterator[list[Case]]:
    """Yield environments whose robots drive to the nearest frontier in rooms, with Hector; a step is a decision."""
    rooms = {"world": "rooms", "world_size": (20.0, 20.0)}
    step = partial(step_environment, "ExploreFrontiers-v0", "kinematic", **rooms)
    yield [Case(f"x {num_envs}", "decisions", 1, partial(step, num_envs)) for num_envs in (1, 16, 64, 256)]


def people() -> Iterator[list[Case]]:
    """Yield vector environments with goals among people."""
    hall = {"world_size": (12.0, 12.0), "observations": ("scan_history", "goal"), "robot": "turtlebot3_burger"}
    step = partial(step_environment, "ReachCrowd-v0", "kinematic", 64, **hall)
    yield [
        Case(f"people: {number}", f"contact {contact}", 1, partial(step, people=number, contact=contact))
        for number, contact in itertools.product((0, 10, 30), ("costs", "ends"))
    ]


def trainings() -> Iterator[list[Case]]:
    """Yield whole trainings, rollouts and updates, on one core and on two."""
    yield [Case(name, f"cores: {cores}", cores, partial(train, name)) for name in TRAININGS for cores in (1, 2)]


def benchmark_robot(num_beams: int = 360) -> RobotParams:
    """Return a TurtleBot3 Burger with a lidar range of 10 m."""
    robot = load_robot("turtlebot3_burger")
    return dataclasses.replace(robot, lidar=dataclasses.replace(robot.lidar, num_beams=num_beams, range_max=10.0))


def make_actions(num_envs: int) -> Iterator[np.ndarray]:
    """Yield reproducible random actions (forward 0.3 to 1, turn -1 to 1): shape (num_envs, 2), float32."""
    table = np.random.default_rng(0).uniform((0.3, -1.0), 1.0, (NUM_ACTIONS, num_envs, 2)).astype(np.float32)
    while True:
        yield from (actions for actions in table for _ in range(ACTION_REPEAT))


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
    drives, is_single = isinstance(env.action_space, gymnasium.spaces.Box), num_envs == 1
    try:
        for actions in make_actions(num_envs) if drives else itertools.repeat(np.zeros(num_envs, dtype=np.int64)):
            result = env.step(actions[0] if is_single else actions)
            if is_single and (result[2] or result[3]):
                env.reset()
            yield num_envs
    finally:
        env.close()


def train(name: str) -> Iterator[int]:
    """Train by a configuration; yield the number of steps of each rollout and its updates."""
    from stable_baselines3.common.logger import Logger

    from lidarnaut.agents.algorithms import build_model, find_algorithm, prepare
    from lidarnaut.agents.config import change, find_configuration, parse_config
    from lidarnaut.agents.recipes import with_recipe
    from lidarnaut.agents.vec_env import make_vec_env
    from lidarnaut.envs.files import read_mapping

    data, _ = with_recipe(read_mapping(find_configuration(name, "experiment")))
    if "num_worlds" in data["environment"]:  # made during the measurement
        data = change(data, {"environment.num_worlds": 4})
    config: Any = parse_config(data, name)
    env = make_vec_env(config)
    model = build_model(prepare(config, find_algorithm(config.algorithm), env), env)
    model.set_logger(Logger(None, []))
    rollout = model.n_steps * model.n_envs
    try:
        while True:
            model.learn(rollout, reset_num_timesteps=False)
            yield rollout
    finally:
        env.close()

"""Environment designs whose throughput is compared."""

import contextlib
import dataclasses
import multiprocessing
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import gymnasium
import numpy as np

import lidarnaut.agents  # noqa: F401  (before torch, whose threads it keeps from spinning)
from lidarnaut.benchmarks.speed.halls import make_hall
from lidarnaut.envs.robots import RobotParams, load_robot

ID = "lidarnaut:lidarnaut/Explore-v0"
ACTION_REPEAT, NUM_ACTIONS = 10, 500
TRAININGS = "reach_crowd", "rooms_fast", "reach_scans"
"""Configurations of the measured trainings."""
FEWEST_ENVS, MOST_ENVS = 16, 256
"""Smallest and largest number of sub-environments of the compared vector environments."""


class Design(NamedTuple):
    """Compared environment design: implementation, number of sub-environments, and cores."""

    name: str
    """Implementation. `bullet`, `kinematic`: single environment with this simulator. `vector`, `bullet_vector`: vector
    environment. `subproc`: `SubprocVecEnv` of stable-baselines3. Name of a training: this training."""
    num_envs: int = 1
    cores: int = 1
    """Number of CPU cores; if above 1, also the number of worker processes of a vector environment."""


DESIGNS = (
    Design("bullet"),
    Design("kinematic"),
    *(Design("vector", num_envs, cores) for cores in (1, 2) for num_envs in (FEWEST_ENVS, 64, MOST_ENVS)),
    *(Design("bullet_vector", FEWEST_ENVS, cores) for cores in (1, 2)),
    *(Design("subproc", 2, cores) for cores in (1, 2)),
)
"""Compared environment designs."""


class Case(NamedTuple):
    """Configuration to be measured: environment design, number of obstacles, SLAM ("tinyslam" or "truth")."""

    design: Design
    num_bodies: int
    slam: str
    num_beams: int = 360
    map_resolution: float = 0.05
    """Side of a map cell [m]."""


class Drive(NamedTuple):
    """Functions that step and close the running environments of one design."""

    step: Callable[[int], object]
    close: Callable[[], object]
    at_once: int
    """Number of steps per sub-environment in each call of `step`."""


def benchmark_robot(num_beams: int = 360) -> RobotParams:
    """Return a TurtleBot3 Burger with a lidar range of 10 m."""
    robot = load_robot("turtlebot3_burger")
    return dataclasses.replace(robot, lidar=dataclasses.replace(robot.lidar, num_beams=num_beams, range_max=10.0))


def make_actions(num_envs: int) -> Iterator[np.ndarray]:
    """Yield reproducible random actions (forward 0.3 to 1, turn -1 to 1): shape (num_envs, 2), float32."""
    table = np.random.default_rng(0).uniform((0.3, -1.0), 1.0, (NUM_ACTIONS, num_envs, 2)).astype(np.float32)
    while True:
        yield from (actions for actions in table for _ in range(ACTION_REPEAT))


def open_drive(case: Case) -> Drive:
    if case.design.name in TRAININGS:
        return _train(case.design)
    name, num_envs, cores = case.design
    physics = "bullet" if name.startswith("bullet") else "kinematic"
    arguments: dict[str, Any] = {"world": make_hall(case.num_bodies), "robot": benchmark_robot(case.num_beams)}
    arguments |= {"slam": case.slam, "physics": physics, "start": "spawn", "map_resolution": case.map_resolution}
    make_single = partial(gymnasium.make, ID, **arguments)
    env: Any
    if name in ("bullet", "kinematic"):
        env = make_single()
        env.reset(seed=0)
    elif name == "subproc":
        from stable_baselines3.common.vec_env import SubprocVecEnv

        multiprocessing.get_context("forkserver").set_forkserver_preload([SubprocVecEnv.__module__, __name__])
        env = SubprocVecEnv([make_single] * num_envs, start_method="forkserver")
        env.seed(0)
        env.reset()
    else:
        # A fork would miss the threads of a training process.
        how: dict[str, Any] = {"context": "forkserver", "num_workers": cores if cores > 1 else 0}
        env = gymnasium.make_vec(ID, num_envs, "vector_entry_point", **how, **arguments)
        env.reset(seed=0)
    actions, is_single = make_actions(num_envs), isinstance(env, gymnasium.Env)

    def step(count: int) -> None:
        for _ in range(count):
            result = env.step(next(actions)[0] if is_single else next(actions))
            if is_single and (result[2] or result[3]):
                env.reset()

    def close() -> None:
        with contextlib.suppress(EOFError, BrokenPipeError):
            env.close()

    return Drive(step, close, at_once=5 if num_envs < 64 else 1)


def _train(design: Design) -> Drive:
    from stable_baselines3.common.logger import Logger

    from lidarnaut.agents.algorithms import build_model, find_algorithm, prepare
    from lidarnaut.agents.config import change, find_configuration, parse_config
    from lidarnaut.agents.recipes import with_recipe
    from lidarnaut.agents.vec_env import make_vec_env
    from lidarnaut.envs.files import read_mapping

    data, _ = with_recipe(read_mapping(find_configuration(design.name, "experiment")))
    data = change(data, {"torch_threads": design.cores})
    if "num_worlds" in data["environment"]:  # made during the measurement
        data = change(data, {"environment.num_worlds": 4})
    config: Any = parse_config(data, design.name)
    env = make_vec_env(config)
    prepared = prepare(config, find_algorithm(config.algorithm), env)
    model = build_model(prepared, env)
    model.set_logger(Logger(None, []))
    learn = partial(model.learn, reset_num_timesteps=False)
    return Drive(learn, env.close, at_once=prepared.rollout_steps)

"""The designs whose throughput is compared, each behind the same two calls."""

import contextlib
import dataclasses
import multiprocessing
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, NamedTuple, Protocol

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode

import agents  # noqa: F401  (before torch, whose threads it keeps from spinning)
from benchmarks.naive import NaiveExploreEnv
from benchmarks.speed.halls import Hall
from envs.robots import RobotParams, load_robot

HOLD = 10
"""Steps for which an action is held: at white noise a robot would tremble on the spot."""
NUM_ACTIONS = 500
"""Actions of a sub-environment before they start again."""
SUBPROCESSES = 2
"""Processes of `subproc`."""
TRAINING = Path(__file__).parents[2] / "configs" / "rooms_fast.yaml"
"""Network and settings of `ppo`; where it learns and in how many sub-environments is up to the benchmark."""


class Design(NamedTuple):
    """What is measured, and on how much of the machine."""

    name: Literal["naive", "bullet", "kinematic", "vector", "bullet_vector", "subproc", "ppo"]
    """`naive`: `benchmarks.naive`. `bullet` and `kinematic`: the single environment under either physics. `vector` and
    `bullet_vector`: `envs.vector`, under either physics. `subproc`: the single kinematic environment in
    stable-baselines3's `SubprocVecEnv`. `ppo`: PPO of stable-baselines3 learning from `vector`, end to end."""
    num_envs: int = 1
    """Environments that step together."""
    cores: int = 1
    """Cores that they may use; from two on, a vector environment has as many shards."""


class Case(NamedTuple):
    """A design at work."""

    design: Design
    num_bodies: int
    """Crates and pillars in the hall."""
    slam: str
    """"tinyslam" or "truth"."""
    num_beams: int = 360
    """Beams of a scan."""
    map_resolution: float = 0.05
    """Side of a map cell [m]; the naive design has 0.05 m alone."""


class Drive(Protocol):
    """Environments of one design that are being stepped."""

    at_once: int
    """Steps of a sub-environment between two looks at the clock."""

    def step(self, count: int) -> None:
        """Step every sub-environment `count` times."""
        ...

    def close(self) -> None:
        """Release what the design holds."""
        ...


def benchmark_robot(num_beams: int = 360) -> RobotParams:
    """Return a TurtleBot3 Burger whose lidar sees 10 m far."""
    robot = load_robot("turtlebot3_burger")
    lidar = dataclasses.replace(robot.lidar, num_beams=num_beams, range_max=10.0)
    return dataclasses.replace(robot, lidar=lidar)


def open_drive(case: Case, hall: Hall) -> Drive:
    """Start driving in the middle of a hall, which must be the one that the case names."""
    import envs  # noqa: F401  (registers the environments)

    design, robot = case.design, benchmark_robot(case.num_beams)
    if design.name == "naive":
        return SingleDrive(NaiveExploreEnv(hall, robot, case.slam))
    arguments: dict[str, Any] = {
        "world": hall.world,
        "robot": robot,
        "physics": "bullet" if design.name.startswith("bullet") else "kinematic",
        "slam": case.slam,
        "start": "spawn",
        "map_resolution": case.map_resolution,
    }
    if design.name in ("vector", "bullet_vector", "ppo"):
        mode = AutoresetMode.SAME_STEP if design.name == "ppo" else AutoresetMode.NEXT_STEP
        # Not forked: a process that learns has threads, which copies of it would miss.
        arguments |= {"autoreset_mode": mode, "num_workers": design.cores if design.cores > 1 else 0}
        arguments |= {"context": "forkserver"}
        env = gymnasium.make_vec("lidarnaut/Explore-v0", design.num_envs, "vector_entry_point", **arguments)
        return TrainingDrive(env, design.cores) if design.name == "ppo" else VectorDrive(env)
    if design.name == "subproc":
        return SubprocDrive(design.num_envs, arguments)
    return SingleDrive(gymnasium.make("lidarnaut/Explore-v0", **arguments))


def make_actions(num_envs: int) -> Iterator[np.ndarray]:
    """Yield actions without end, shape (num_envs, 2), float32: forward, turning either way; the same at every run."""
    rng = np.random.default_rng(0)
    table = rng.uniform((0.3, -1.0), 1.0, (NUM_ACTIONS, num_envs, 2)).astype(np.float32)
    while True:
        for actions in table:
            for _ in range(HOLD):
                yield actions


class SingleDrive:
    """One environment."""

    at_once = 5

    def __init__(self, env: gymnasium.Env) -> None:
        self._env = env
        self._actions = make_actions(1)
        env.reset(seed=0)

    def step(self, count: int) -> None:
        for _ in range(count):
            _, _, terminated, truncated, _ = self._env.step(next(self._actions)[0])
            if terminated or truncated:
                self._env.reset()

    def close(self) -> None:
        self._env.close()


class VectorDrive:
    """A Gymnasium vector environment."""

    def __init__(self, env: gymnasium.vector.VectorEnv) -> None:
        self._env = env
        self.at_once = 5 if env.num_envs < 64 else 1
        self._actions = make_actions(env.num_envs)
        env.reset(seed=0)

    def step(self, count: int) -> None:
        for _ in range(count):
            self._env.step(next(self._actions))

    def close(self) -> None:
        self._env.close()


class SubprocDrive:
    """Single environments in processes of their own, under stable-baselines3's `SubprocVecEnv`."""

    at_once = 5

    def __init__(self, num_envs: int, arguments: dict[str, Any]) -> None:
        from stable_baselines3.common.vec_env import SubprocVecEnv

        # Imported once in the process that the others are forked from.
        multiprocessing.get_context("forkserver").set_forkserver_preload([SubprocVecEnv.__module__, __name__])
        self._env = SubprocVecEnv([lambda: _make_registered(arguments)] * num_envs, start_method="forkserver")
        self._actions = make_actions(num_envs)
        self._env.seed(0)
        self._env.reset()

    def step(self, count: int) -> None:
        for _ in range(count):
            self._env.step(next(self._actions))

    def close(self) -> None:
        with contextlib.suppress(EOFError, BrokenPipeError):
            self._env.close()


class TrainingDrive:
    """PPO with the network and the settings of `configs/rooms_fast.yaml`: rollouts and updates."""

    def __init__(self, env: gymnasium.vector.VectorEnv, cores: int) -> None:
        from stable_baselines3.common.logger import Logger

        from agents.config import TrainingConfig
        from agents.ppo import build_model
        from agents.vec_env import GymnasiumVecEnv
        from envs.files import read_record

        config = read_record(TRAINING, TrainingConfig).model_copy(update={"torch_threads": cores})
        self.at_once = config.ppo.num_steps
        self._env = GymnasiumVecEnv(env)
        self._model = build_model(config, self._env)
        self._model.set_logger(Logger(None, []))

    def step(self, count: int) -> None:
        self._model.learn(count * self._env.num_envs, reset_num_timesteps=False)

    def close(self) -> None:
        self._env.close()


def _make_registered(arguments: dict[str, Any]) -> gymnasium.Env:
    import envs  # noqa: F401  (registers the environments)

    return gymnasium.make("lidarnaut/Explore-v0", **arguments)

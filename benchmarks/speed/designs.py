"""The designs whose throughput is compared, each behind the same two calls."""

import contextlib
import dataclasses
import multiprocessing
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, NamedTuple

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode

import agents  # noqa: F401  (before torch, whose threads it keeps from spinning)
from benchmarks.speed.halls import Hall
from benchmarks.speed.naive import NaiveExploreEnv
from envs.robots import RobotParams, load_robot

HOLD = 10
"""Steps for which an action is held: at white noise a robot would tremble on the spot."""
NUM_ACTIONS = 500
"""Actions of a sub-environment before they start again."""
SUBPROCESSES = 2
TRAINING = Path(__file__).parents[2] / "configs" / "rooms_fast.yaml"
"""Network and settings of `ppo`; where it learns and in how many sub-environments is up to the benchmark."""


class Design(NamedTuple):
    """What is measured, and on how much of the machine."""

    name: Literal["naive", "bullet", "kinematic", "vector", "bullet_vector", "subproc", "ppo"]
    """`naive`: `benchmarks.speed.naive`. `bullet` and `kinematic`: the single environment under either physics.
    `vector` and `bullet_vector`: `envs.vector`, under either physics. `subproc`: the single kinematic environment in
    stable-baselines3's `SubprocVecEnv`. `ppo`: PPO of stable-baselines3 learning from `vector`, end to end."""
    num_envs: int = 1
    cores: int = 1
    """Cores that they may use; from two on, a vector environment has as many shards."""


class Case(NamedTuple):
    """A design at work in a hall, under "tinyslam" or "truth"."""

    design: Design
    num_bodies: int
    slam: str
    num_beams: int = 360
    map_resolution: float = 0.05
    """Side of a map cell [m]; the naive design has 0.05 m alone."""


def benchmark_robot(num_beams: int = 360) -> RobotParams:
    """Return a TurtleBot3 Burger whose lidar sees 10 m far."""
    robot = load_robot("turtlebot3_burger")
    lidar = dataclasses.replace(robot.lidar, num_beams=num_beams, range_max=10.0)
    return dataclasses.replace(robot, lidar=lidar)


def open_drive(case: Case, hall: Hall) -> "Drive":
    """Start driving in the middle of a hall, which must be the one that the case names."""
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
    if design.name == "subproc":
        return Drive(_subprocesses(design.num_envs, arguments), design.num_envs)
    if design.name not in ("vector", "bullet_vector", "ppo"):
        return SingleDrive(_make_registered(arguments))
    mode = AutoresetMode.SAME_STEP if design.name == "ppo" else AutoresetMode.NEXT_STEP
    # Not forked: a process that learns has threads, which copies of it would miss.
    arguments |= {"autoreset_mode": mode, "num_workers": design.cores if design.cores > 1 else 0}
    arguments |= {"context": "forkserver"}
    env = gymnasium.make_vec("lidarnaut/Explore-v0", design.num_envs, "vector_entry_point", **arguments)
    if design.name == "ppo":
        return TrainingDrive(env, design.cores)
    env.reset(seed=0)
    return Drive(env, design.num_envs)


def _make_registered(arguments: dict[str, Any]) -> gymnasium.Env:
    import envs  # noqa: F401  (registers the environments, also in the processes of `subproc`)

    return gymnasium.make("lidarnaut/Explore-v0", **arguments)


def _subprocesses(num_envs: int, arguments: dict[str, Any]) -> Any:
    """Return single environments in processes under stable-baselines3's `SubprocVecEnv`, after a reset."""
    from stable_baselines3.common.vec_env import SubprocVecEnv

    # Imported once in the process that the others are forked from.
    multiprocessing.get_context("forkserver").set_forkserver_preload([SubprocVecEnv.__module__, __name__])
    env = SubprocVecEnv([lambda: _make_registered(arguments)] * num_envs, start_method="forkserver")
    env.seed(0)
    env.reset()
    return env


def make_actions(num_envs: int) -> Iterator[np.ndarray]:
    """Yield actions without end, shape (num_envs, 2), float32: forward, turning either way; the same at every run."""
    rng = np.random.default_rng(0)
    table = rng.uniform((0.3, -1.0), 1.0, (NUM_ACTIONS, num_envs, 2)).astype(np.float32)
    while True:
        for actions in table:
            for _ in range(HOLD):
                yield actions


class Drive:
    """Environments of one design that are being stepped."""

    def __init__(self, env: Any, num_envs: int = 1) -> None:
        """Take an environment after its reset, which steps with an action for each of `num_envs`."""
        self.at_once = 5 if num_envs < 64 else 1
        """Steps of a sub-environment between two looks at the clock."""
        self._env, self._actions = env, make_actions(num_envs)

    def step(self, count: int) -> None:
        """Step every sub-environment `count` times."""
        for _ in range(count):
            self._env.step(next(self._actions))

    def close(self) -> None:
        """Release what the design holds."""
        with contextlib.suppress(EOFError, BrokenPipeError):
            self._env.close()


class SingleDrive(Drive):
    """One environment."""

    def __init__(self, env: gymnasium.Env) -> None:
        super().__init__(env)
        env.reset(seed=0)

    def step(self, count: int) -> None:
        for _ in range(count):
            _, _, terminated, truncated, _ = self._env.step(next(self._actions)[0])
            if terminated or truncated:
                self._env.reset()


class TrainingDrive(Drive):
    """PPO with the network and the settings of `configs/rooms_fast.yaml`: rollouts and updates."""

    def __init__(self, env: gymnasium.vector.VectorEnv, cores: int) -> None:
        from stable_baselines3.common.logger import Logger

        from agents.algorithms import build_model
        from agents.config import TrainingConfig
        from agents.vec_env import GymnasiumVecEnv
        from envs.files import read_record

        config = read_record(TRAINING, TrainingConfig).model_copy(update={"torch_threads": cores})
        super().__init__(GymnasiumVecEnv(env), env.num_envs)
        self.at_once = config.hyperparameters["n_steps"]
        self._model = build_model(config, self._env)
        self._model.set_logger(Logger(None, []))

    def step(self, count: int) -> None:
        self._model.learn(count * self._env.num_envs, reset_num_timesteps=False)

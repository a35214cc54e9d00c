"""Several environments that take turns, here or in a process of their own.

Kept free of torch, so that such a process starts fast and stays small.
"""

import multiprocessing
import signal
import traceback
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from typing import Any, Literal, NamedTuple

import gymnasium
import numpy as np

from agents.config import EnvironmentConfig

Observations = dict[str, np.ndarray]
"""Observations of several environments, stacked along axis 0."""


def make_environment(config: EnvironmentConfig, split: str) -> gymnasium.Env:
    """Make one environment on the worlds of a split ("train" or "test")."""
    import envs  # noqa: F401  (registers the environments)

    arguments = config.model_dump(exclude={"id"})
    return gymnasium.make(config.id, split=split, **arguments)


class Transition(NamedTuple):
    """What a step of several environments returns. Environments whose episode ended have started a new one."""

    observations: Observations
    rewards: np.ndarray
    """Shape (num_envs,), float32."""
    dones: np.ndarray
    """Shape (num_envs,), bool."""
    infos: list[dict[str, Any]]
    """Empty but at the end of an episode."""


class Lanes:
    """Environments that are stepped one after the other."""

    def __init__(self, makers: Sequence[Callable[[], gymnasium.Env]]) -> None:
        self.envs = [make() for make in makers]
        self._returns = np.zeros(len(self.envs))
        self._lengths = np.zeros(len(self.envs), dtype=np.int64)

    def spaces(self) -> tuple[gymnasium.Space, gymnasium.Space]:
        """Return the observation space and the action space."""
        return self.envs[0].observation_space, self.envs[0].action_space

    def reset(self, seeds: Sequence[int | None]) -> Observations:
        """Start an episode everywhere."""
        self._returns[:] = 0.0
        self._lengths[:] = 0
        return stack([env.reset(seed=seed)[0] for env, seed in zip(self.envs, seeds, strict=True)])

    def step(self, actions: np.ndarray) -> Transition:
        """Step everywhere; `infos` carry what stable-baselines3 looks for at the end of an episode."""
        observations, rewards, dones, infos = [], [], [], []
        for lane, env in enumerate(self.envs):
            observation, reward, terminated, truncated, info = env.step(actions[lane])
            self._returns[lane] += float(reward)
            self._lengths[lane] += 1
            done = terminated or truncated
            infos.append(self._end_episode(lane, observation, truncated and not terminated, info) if done else {})
            observations.append(env.reset()[0] if done else observation)
            rewards.append(float(reward))
            dones.append(done)
        return Transition(stack(observations), np.array(rewards, dtype=np.float32), np.array(dones), infos)

    def close(self) -> None:
        """Close the environments."""
        for env in self.envs:
            env.close()

    def _end_episode(self, lane: int, observation: Any, cut_short: bool, info: dict[str, Any]) -> dict[str, Any]:
        episode = {"r": float(self._returns[lane]), "l": int(self._lengths[lane])}
        for name in ("explored_fraction", "collisions"):
            episode[name] = float(info[name])
        self._returns[lane] = 0.0
        self._lengths[lane] = 0
        return {
            "episode": episode,
            "is_success": bool(info["is_success"]),
            "terminal_observation": observation,
            "TimeLimit.truncated": cut_short,
        }


def stack(observations: list[dict[str, np.ndarray]]) -> Observations:
    """Stack the observations of several environments along a new axis 0."""
    return {key: np.stack([observation[key] for observation in observations]) for key in observations[0]}


class EnvironmentProcessError(RuntimeError):
    """An environment failed in its process; the message holds what happened there."""


class RemoteLanes:
    """`Lanes` in a process of their own; `begin` a call, do something else, and `finish` it."""

    def __init__(
        self, makers: Sequence[Callable[[], gymnasium.Env]], start_method: Literal["forkserver", "spawn"]
    ) -> None:
        context = multiprocessing.get_context(start_method)
        self._pipe, far_end = context.Pipe()
        self._process = context.Process(target=_serve, args=(far_end, makers), daemon=True)  # type: ignore[attr-defined]
        self._process.start()
        far_end.close()

    def begin(self, method: str, *arguments: Any) -> None:
        """Ask the process to call a method of its lanes."""
        self._pipe.send((method, arguments))

    def finish(self) -> Any:
        """Wait for the result of the last `begin`.

        Raises:
            EnvironmentProcessError: if the call raised there, or the process is gone.
        """
        try:
            result, failure = self._pipe.recv()
        except (EOFError, ConnectionResetError):
            self._process.join()
            raise EnvironmentProcessError(
                f"a process that runs environments died with exit code {self._process.exitcode}; -9 is often a lack of "
                "memory"
            ) from None
        if failure is not None:
            raise EnvironmentProcessError(f"an environment failed in its process:\n{failure}")
        return result

    def close(self) -> None:
        """End the process."""
        self._pipe.close()
        self._process.join(timeout=5.0)
        if self._process.is_alive():
            self._process.terminate()


def _serve(pipe: Connection, makers: Sequence[Callable[[], gymnasium.Env]]) -> None:
    """Answer calls until the other end of the pipe closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the training decides what it means.
    lanes: Lanes | None = None
    while True:
        try:
            method, arguments = pipe.recv()
        except (EOFError, ConnectionResetError):
            break
        try:
            lanes = lanes or Lanes(makers)
            result, failure = getattr(lanes, method)(*arguments), None
        except Exception:
            result, failure = None, traceback.format_exc()
        pipe.send((result, failure))
    if lanes is not None:
        lanes.close()

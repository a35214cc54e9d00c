"""Many environments side by side, in this process or spread over a few."""

import itertools
from collections.abc import Callable, Sequence
from typing import Any, Literal, NoReturn

import gymnasium
import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from agents.lanes import Lanes, Observations, RemoteLanes


class ParallelVecEnv(VecEnv):
    """The vector environment that stable-baselines3 asks for.

    It returns the same episodes however many processes it uses: environment i is seeded with seed + i. Unlike the
    vector environments that come with stable-baselines3, a process runs several environments, and `infos` are filled at
    the end of an episode only, which spares copying them at each step.
    """

    def __init__(
        self,
        makers: Sequence[Callable[[], gymnasium.Env]],
        processes: int = 0,
        start_method: Literal["forkserver", "spawn"] = "forkserver",
    ) -> None:
        """Start the environments.

        Args:
            makers: one function per environment; picklable where processes are used.
            processes: number of processes; 0 runs all environments in this one.
            start_method: "forkserver" or "spawn".
        """
        bounds = np.linspace(0, len(makers), max(processes, 1) + 1).round().astype(int)
        self._slices = [slice(int(a), int(b)) for a, b in itertools.pairwise(bounds)]
        self._local = None if processes else Lanes(makers)
        self._remotes = [RemoteLanes(makers[part], start_method) for part in self._slices] if processes else []
        super().__init__(len(makers), *self._call("spaces")[0])

    def reset(self) -> Observations:
        """Start an episode everywhere, with the seeds of the last call of `seed`."""
        parts = self._call("reset", [(self._seeds[part],) for part in self._slices])
        self._reset_seeds()
        return _concatenate(parts)

    def step_async(self, actions: np.ndarray) -> None:
        """Begin a step."""
        self._actions = [actions[part] for part in self._slices]
        for remote, part in zip(self._remotes, self._actions, strict=False):
            remote.begin("step", part)

    def step_wait(self) -> tuple[Observations, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Finish the step that `step_async` began."""
        parts = [self._local.step(self._actions[0])] if self._local else [remote.finish() for remote in self._remotes]
        return (
            _concatenate([part.observations for part in parts]),
            np.concatenate([part.rewards for part in parts]),
            np.concatenate([part.dones for part in parts]),
            [info for part in parts for info in part.infos],
        )

    def close(self) -> None:
        """Close the environments and end their processes."""
        if self._local:
            self._local.close()
        for remote in self._remotes:
            remote.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return None for `render_mode`, the one attribute that training asks for."""
        if attr_name != "render_mode":
            self._refuse()
        return [None] * self.num_envs

    def env_is_wrapped(self, wrapper_class: type[gymnasium.Wrapper], indices: Any = None) -> list[bool]:
        """Return False: episodes are counted here, no wrapper is needed."""
        return [False] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refuse."""
        self._refuse()

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Refuse."""
        self._refuse()

    def _refuse(self) -> NoReturn:
        raise NotImplementedError("the environments may run in other processes; reach into them through a Lanes object")

    def _call(self, method: str, arguments: Sequence[tuple] | None = None) -> list[Any]:
        """Call a method of all lanes at once; `arguments` has an entry per part."""
        arguments = arguments or [()] * len(self._slices)
        if self._local:
            return [getattr(self._local, method)(*arguments[0])]
        for remote, part in zip(self._remotes, arguments, strict=True):
            remote.begin(method, *part)
        return [remote.finish() for remote in self._remotes]


def _concatenate(parts: list[Observations]) -> Observations:
    if len(parts) == 1:
        return parts[0]
    return {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}

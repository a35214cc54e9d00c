"""Worlds of successive episodes, with a random generator of their own."""

import copy
from typing import Any

import numpy as np

from lidarnaut.envs.task import Task
from lidarnaut.envs.worlds import World

WORLD_SPAWN_KEY = 2**32 - 1
"""Spawn key of the random generator for worlds. `Generator.spawn` never produces this key."""


class EpisodeWorlds:
    """Draws the worlds of a task's episodes, also in advance.

    The first world of a seed comes from the generator of the environment, later ones from a generator made of its seed.
    """

    def __init__(self, task: Task) -> None:
        self._task = task
        self._root: np.random.Generator | None = None
        self._prepared: tuple[Any, ...] = (None,) * 4

    def prepare(self, root: np.random.Generator) -> None:
        """Draw the next world in advance if the task permits this; may run in another thread between two resets.

        `root`: generator of the environment.
        """
        sampler = self._task.sampler_ahead
        if sampler is not None and self._root is root:
            before, after = self._rng, copy.deepcopy(self._rng)
            self._prepared = sampler, before, after, self._task.draw_world(None, after)

    def next(self, wanted: Any, root: np.random.Generator) -> World:
        """Return the world of the next episode; `wanted`: as in `Task.draw_world`."""
        (sampler, before, after, world), self._prepared = self._prepared, (None,) * 4
        if self._root is not root:
            seed: Any = root.bit_generator.seed_seq
            key = (*seed.spawn_key, WORLD_SPAWN_KEY)
            self._root = root
            self._rng = np.random.default_rng(np.random.SeedSequence(seed.entropy, spawn_key=key))
            return self._task.draw_world(wanted, root)
        if wanted is None and before is self._rng and sampler is self._task.sampler_ahead:
            self._rng = after
            return world
        rng = copy.deepcopy(self._rng)  # `prepare` may copy the original now
        try:
            return self._task.draw_world(wanted, rng)
        finally:
            self._rng = rng

"""The environments of an experiment, one or many."""

import multiprocessing
from typing import Any, Literal

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv

import envs  # noqa: F401  (registers the environments)
from agents.config import EnvironmentConfig

Observations = dict[str, np.ndarray]
"""Observations of several environments, stacked along axis 0."""


def make_env(config: EnvironmentConfig, split: Literal["train", "test"]) -> gymnasium.Env:
    """Make one environment on the worlds of a split."""
    return gymnasium.make(config.id, split=split, **config.arguments)


def make_vector(
    config: EnvironmentConfig, split: Literal["train", "test"], num_envs: int
) -> VectorEnv[Observations, np.ndarray, np.ndarray]:
    """Make several environments on the worlds of a split. One whose episode ends starts the next at once."""
    arguments = {**config.arguments, "split": split}
    settings: dict[str, Any] = {"autoreset_mode": AutoresetMode.SAME_STEP}
    if config.vectorization != "sync":
        # Never "fork": torch has threads, and a copy of a process whose threads are gone may hang.
        methods = multiprocessing.get_all_start_methods()
        settings["context"] = "forkserver" if "forkserver" in methods else "spawn"
    if config.vectorization == "native":
        settings["num_workers"] = config.num_workers
        return gymnasium.make_vec(config.id, num_envs, "vector_entry_point", **settings, **arguments)
    return gymnasium.make_vec(
        config.id, num_envs, vectorization_mode=config.vectorization, vector_kwargs=settings, **arguments
    )

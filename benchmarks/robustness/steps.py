"""Many steps in a vector environment: whether its memory stays as it is."""

import os
from dataclasses import dataclass

import gymnasium
import numpy as np

from envs.progress import Progress

NUM_ENVS = 16
"""Sub-environments."""
SAMPLES = 40
"""How often memory is measured."""
MIB = 2**20


@dataclass(frozen=True)
class Memory:
    """Memory of the process over a run."""

    slam: str
    steps: int
    """Of all sub-environments together."""
    episodes: int
    """That ended."""
    middle: float
    """Greatest resident memory in the second quarter of the run [MiB]."""
    end: float
    """Greatest resident memory in the last quarter [MiB]."""


def take_steps(slam: str, count: int, seed: int, *, progress: bool = True) -> Memory:
    """Take `count` random steps in ever new worlds of 8 m, on this process alone.

    Raises:
        OSError: the operating system does not tell how much memory is used.
    """
    env = gymnasium.make_vec(
        "lidarnaut/Explore-v0", NUM_ENVS, world="rooms", world_size=(8.0, 8.0), physics="kinematic", slam=slam,
        control_hz=5.0, time_limit=20.0, num_workers=1,
    )  # fmt: skip
    rng = np.random.default_rng(seed)
    env.reset(seed=seed)
    rounds, samples, episodes = max(count // NUM_ENVS, SAMPLES), [], 0
    for k in Progress(range(rounds), desc=f"steps with {slam}", unit="round", disable=not progress):
        actions = rng.uniform((-0.2, -1.0), 1.0, (NUM_ENVS, 2)).astype(np.float32)
        _, _, terminated, truncated, _ = env.step(actions)
        episodes += int(np.count_nonzero(terminated | truncated))
        if k % (rounds // SAMPLES) == 0:
            samples.append(resident())
    env.close()
    quarter = len(samples) // 4
    middle, end = max(samples[quarter : 2 * quarter]), max(samples[-quarter:])
    return Memory(slam, rounds * NUM_ENVS, episodes, middle / MIB, end / MIB)


def resident() -> int:
    """Return the resident memory of this process [bytes]."""
    with open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")

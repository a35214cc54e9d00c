"""The same seed in other processes, after other episodes, and with other numbers of threads."""

import hashlib
from typing import Any

import gymnasium
import numpy as np

from envs.progress import Progress

from . import Report, call_elsewhere

CASES: dict[str, tuple[str, dict[str, Any]]] = {
    **{f"Explore-v0, {slam}": ("Explore", {"slam": slam}) for slam in ("tinyslam", "hector", "gmapping", "graph")},
    "Explore-v0, bullet": ("Explore", {"physics": "bullet"}),
    "ExploreFrontiers-v0": ("ExploreFrontiers", {}),
    "ExploreTeam-v0": ("ExploreTeam", {"num_robots": 2}),
    "Navigate-v0": ("Navigate", {}),
}
"""Ids and arguments."""
COMMON = {"world": "rooms", "world_size": (8.0, 8.0), "physics": "kinematic", "control_hz": 5.0}
WAYS: dict[str, tuple[int, dict[str, str]]] = {
    "in another process": (0, {}),
    "after two other episodes": (2, {}),
    "with one thread": (0, {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}),
    "with four threads": (0, {"OMP_NUM_THREADS": "4", "NUMBA_NUM_THREADS": "4"}),
    "with another hash seed": (0, {"PYTHONHASHSEED": "77"}),
}
"""What differs from the episodes in the calling process: episodes before, variables of the environment."""


def repeat(seed: int, steps: int = 100) -> Report:
    """Compare an episode of each case with the same seed elsewhere, to the last byte."""
    wanted, rows, failures = digests(seed, steps), [], []
    for way, (after, variables) in Progress(WAYS.items(), desc="repeats", unit="process"):
        found = call_elsewhere(digests, seed, steps, after, **variables)
        different = [case for case in CASES if found[case] != wanted[case]]
        rows.append({"the same seed": way, "episodes": len(CASES), "other bytes": len(different)})
        failures += [f"{case} differs {way}" for case in different]
    return rows, failures


def digests(seed: int, steps: int, after: int = 0) -> dict[str, str]:
    """Return the SHA-256 of an episode of each case; see `digest`."""
    return {case: digest(case, seed, steps, after) for case in CASES}


def digest(case: str, seed: int, steps: int, after: int = 0) -> str:
    """Return the SHA-256 of at most so many steps: observations, rewards, ends and what `info` says of the moment.

    `after` are episodes with other seeds that the same environment runs before.
    """
    id, arguments = CASES[case]
    env = gymnasium.make(f"envs:lidarnaut/{id}-v0", **COMMON | arguments).unwrapped
    for other in range(after):
        env.reset(seed=1000 + seed + other)
        for _ in range(5):
            env.step(env.action_space.sample())
    found = hashlib.sha256()
    observation, info = env.reset(seed=seed)
    env.action_space.seed(seed)
    for _ in range(steps):
        for name in sorted(observation):
            found.update(observation[name].tobytes())
        found.update(repr((info["time"], np.asarray(info["pose_error"]).tolist(), info["rewards"])).encode())
        observation, _, terminated, truncated, info = env.step(env.action_space.sample())
        if terminated or truncated:
            break
    env.close()
    return found.hexdigest()

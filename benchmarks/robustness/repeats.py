"""The same seed in other processes, after other episodes, and with other numbers of threads."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

import envs  # noqa: F401  registers the environments

ROOT = Path(__file__).parents[2]
"""Folder of the checkout."""
CASES: dict[str, tuple[str, dict[str, Any]]] = {
    **{f"Explore-v0, {slam}": ("Explore", {"slam": slam}) for slam in ("tinyslam", "hector", "gmapping", "graph")},
    "Explore-v0, bullet": ("Explore", {"physics": "bullet"}),
    "ExploreFrontiers-v0": ("ExploreFrontiers", {}),
    "ExploreTeam-v0": ("ExploreTeam", {"num_robots": 2}),
    "Navigate-v0": ("Navigate", {}),
}
"""Ids and arguments."""
COMMON = {"world": "rooms", "world_size": (8.0, 8.0), "physics": "kinematic", "control_hz": 5.0}
WAYS = {
    "in another process": {},
    "after two other episodes": {"after": "2"},
    "with one thread": {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"},
    "with four threads": {"OMP_NUM_THREADS": "4", "NUMBA_NUM_THREADS": "4"},
    "with another hash seed": {"PYTHONHASHSEED": "77"},
}
"""What differs from the episode in the calling process; `after` is no variable of the environment."""


def digest(case: str, seed: int, steps: int, after: int = 0) -> str:
    """Return the SHA-256 of an episode: observations, rewards, ends and what `info` says of the moment.

    Args:
        case: of `CASES`.
        seed: of the episode.
        steps: at most so many.
        after: episodes with other seeds that the same environment runs before.
    """
    id, arguments = CASES[case]
    env = gymnasium.make(f"lidarnaut/{id}-v0", **COMMON | arguments).unwrapped
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


def digest_elsewhere(cases: list[str], way: str, seed: int, steps: int) -> list[str]:
    """Return the digests of episodes in another process that differs in a way of `WAYS`.

    Raises:
        RuntimeError: the process failed.
    """
    variables = dict(WAYS[way])
    after = variables.pop("after", "0")
    command = [sys.executable, "-m", "benchmarks.robustness.repeats", str(seed), str(steps), after, *cases]
    environment = {**os.environ, **variables, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)} failed: {done.stderr[-2000:]}")
    return done.stdout.split()


if __name__ == "__main__":
    seed, steps, after = map(int, sys.argv[1:4])
    for case in sys.argv[4:]:
        print(digest(case, seed, steps, after))

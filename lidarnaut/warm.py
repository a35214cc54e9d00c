"""Compiles ahead what environments, SLAMs and explorers need: python -m lidarnaut.warm."""

import importlib.util
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import gymnasium
from tqdm import tqdm

from agents.learned import find_policy, load_policy
from baselines import EXPLORERS, make_explorer
from baselines.episode import run_episode
from envs.slam import SLAM_NAMES

EXPLORE = "lidarnaut/Explore-v0"
IDS = (EXPLORE, *(f"lidarnaut/{name}-v0" for name in ("ExploreFrontiers", "ExploreTeam", "Navigate", "Track")))


def warm() -> None:
    """Run the first seconds of an episode of everything, behind a progress bar."""
    for case in tqdm([*_cases()], desc="compiling kernels, once on this machine", unit="case"):
        case()


def _cases() -> Iterator[Callable[[], None]]:
    for name in ("kinematic", *(["bullet"] if importlib.util.find_spec("pybullet") else [])):
        yield from (partial(_step, gymnasium.make, id, physics=name) for id in IDS)
    yield partial(_step, gymnasium.make, EXPLORE, physics="kinematic", world="caves")
    yield partial(_step, gymnasium.make_vec, EXPLORE, num_envs=2, num_workers=1)
    yield from (partial(_step, gymnasium.make, EXPLORE, physics="kinematic", slam=slam) for slam in SLAM_NAMES)
    yield from (partial(_explore, partial(make_explorer, name)) for name in EXPLORERS)
    for name in ("frontiers", "twist"):
        yield partial(_explore, partial(load_policy, find_policy(f"pretrained/{name}")))


def _step(make: Any, id: str, **arguments: Any) -> None:
    env = make(id, **arguments)
    env.reset(seed=0)
    for _ in range(30):
        env.step(env.action_space.sample())
    env.close()


def _explore(make: Any) -> None:
    arguments: dict[str, Any] = {"observations": ("scan", "motion", "plan"), "time_limit": 5.0}
    env = gymnasium.make(EXPLORE, world="turtlebot3_world", physics="kinematic", **arguments)
    run_episode(env, make(), seed=0)
    env.close()


if __name__ == "__main__":
    warm()

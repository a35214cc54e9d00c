"""Lidarnaut: Gymnasium environments for lidar robots that explore unknown worlds and navigate among people.

`import lidarnaut` registers the environments for `gymnasium.make`, and loads no other part of the package. The names
below are imported on first use, and form the public API. Other modules may change between versions without notice.
"""

import importlib.metadata
from typing import TYPE_CHECKING, Any

from lidarnaut.envs import register

if TYPE_CHECKING:
    from lidarnaut.agents.export import export_policy
    from lidarnaut.agents.policies import make_policy
    from lidarnaut.agents.start import train
    from lidarnaut.baselines import policies_for
    from lidarnaut.baselines.episode import Episode, run_episode
    from lidarnaut.benchmarks.arena.evaluate import evaluate
    from lidarnaut.driver import Driver
    from lidarnaut.envs.core import LidarEnv
    from lidarnaut.envs.robots import RobotParams, robots
    from lidarnaut.envs.simulation.crowd import Crowd
    from lidarnaut.envs.task import Task
    from lidarnaut.envs.worlds import load_world, save_map, worlds

__all__ = [
    "Crowd",
    "Driver",
    "Episode",
    "LidarEnv",
    "RobotParams",
    "Task",
    "__version__",
    "evaluate",
    "export_policy",
    "load_world",
    "make_policy",
    "policies_for",
    "register",
    "robots",
    "run_episode",
    "save_map",
    "train",
    "worlds",
]

_MODULES = {
    "Crowd": "envs.simulation.crowd",
    "Driver": "driver",
    "Episode": "baselines.episode",
    "LidarEnv": "envs.core",
    "RobotParams": "envs.robots",
    "Task": "envs.task",
    "evaluate": "benchmarks.arena.evaluate",
    "export_policy": "agents.export",
    "load_world": "envs.worlds",
    "make_policy": "agents.policies",
    "policies_for": "baselines",
    "robots": "envs.robots",
    "run_episode": "baselines.episode",
    "save_map": "envs.worlds",
    "train": "agents.start",
    "worlds": "envs.worlds",
}

_EARLIER = {"load_policy": "agents.learned", "make_explorer": "agents.policies"}
"""Modules of names of earlier versions, which `make_policy` replaces."""

try:
    __version__ = importlib.metadata.version("lidarnaut")
except importlib.metadata.PackageNotFoundError:  # a checkout on the path that is not installed
    __version__ = "0+unknown"


def __getattr__(name: str) -> Any:
    if name not in _MODULES | _EARLIER:
        raise AttributeError(f"module 'lidarnaut' has no attribute {name!r}; its names are {', '.join(__all__)}")
    value = globals()[name] = getattr(importlib.import_module(f"lidarnaut.{(_MODULES | _EARLIER)[name]}"), name)
    return value


def __dir__() -> list[str]:
    return __all__

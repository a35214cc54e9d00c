"""Lidarnaut: Gymnasium environments for lidar robots that explore unknown worlds and navigate among people.

`import lidarnaut` registers the environments for `gymnasium.make`, and loads no other part of the package. The names
below are imported on first use, and form the public API. Other modules may change between versions without notice.
"""

import importlib.metadata
from typing import TYPE_CHECKING, Any

from lidarnaut.envs import register as register

if TYPE_CHECKING:
    from lidarnaut.agents.export import export_policy as export_policy
    from lidarnaut.agents.policies import make_policy as make_policy
    from lidarnaut.agents.training import train as train
    from lidarnaut.baselines import policies_for as policies_for
    from lidarnaut.baselines.episode import Episode as Episode
    from lidarnaut.baselines.episode import run_episode as run_episode
    from lidarnaut.benchmarks.arena.evaluate import evaluate as evaluate
    from lidarnaut.driver.driver import Driver as Driver
    from lidarnaut.envs.core import LidarEnv as LidarEnv
    from lidarnaut.envs.robots import RobotParams as RobotParams
    from lidarnaut.envs.robots import export_urdf as export_urdf
    from lidarnaut.envs.robots import robots as robots
    from lidarnaut.envs.simulation.crowd import Crowd as Crowd
    from lidarnaut.envs.task import Task as Task
    from lidarnaut.envs.worlds import load_world as load_world
    from lidarnaut.envs.worlds import save_map as save_map
    from lidarnaut.envs.worlds import worlds as worlds

_MODULES = {
    "Crowd": "envs.simulation.crowd",
    "Driver": "driver.driver",
    "Episode": "baselines.episode",
    "LidarEnv": "envs.core",
    "RobotParams": "envs.robots",
    "Task": "envs.task",
    "evaluate": "benchmarks.arena.evaluate",
    "export_policy": "agents.export",
    "export_urdf": "envs.robots",
    "load_world": "envs.worlds",
    "make_policy": "agents.policies",
    "policies_for": "baselines",
    "robots": "envs.robots",
    "run_episode": "baselines.episode",
    "save_map": "envs.worlds",
    "train": "agents.training",
    "worlds": "envs.worlds",
}

__all__ = sorted([*_MODULES, "register", "__version__"])

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

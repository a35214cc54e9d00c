"""Many environments as one: shards of them in worker processes."""

from collections.abc import Callable
from typing import Any

import gymnasium

from .vector_env import LidarVectorEnv

__all__ = [
    "ExploreFrontiersAbstractVectorEnv",
    "ExploreFrontiersVectorEnv",
    "ExploreTeamVectorEnv",
    "ExploreVectorEnv",
    "LidarVectorEnv",
    "NavigateVectorEnv",
    "TrackVectorEnv",
]


def _vector_of(entry_point: str) -> Callable[..., LidarVectorEnv]:
    """Return what makes a vector environment of the environments that an entry point names, kinematic unless said."""

    def make(num_envs: int = 1, *, physics: str = "kinematic", **arguments: Any) -> LidarVectorEnv:
        make_env = gymnasium.envs.registration.load_env_creator(entry_point)
        return LidarVectorEnv(make_env, num_envs, physics=physics, **arguments)

    return make


ExploreVectorEnv = _vector_of("envs.explore:ExploreEnv")
ExploreFrontiersVectorEnv = _vector_of("envs.explore_frontiers:ExploreFrontiersEnv")
ExploreFrontiersAbstractVectorEnv = _vector_of("envs.abstract:ExploreFrontiersAbstractEnv")
ExploreTeamVectorEnv = _vector_of("envs.explore_team:ExploreTeamEnv")
NavigateVectorEnv = _vector_of("envs.navigate:NavigateEnv")
TrackVectorEnv = _vector_of("envs.track:TrackEnv")

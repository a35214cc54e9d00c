"""Vector environments with worker processes."""

from functools import partial
from typing import Any

from gymnasium.envs.registration import load_env_creator

from .vector_env import LidarVectorEnv, make_vec

__all__ = ["LidarVectorEnv", "make_vec"]


def _make(entry_point: str, num_envs: int = 1, *, physics: str = "kinematic", **arguments: Any) -> LidarVectorEnv:
    return LidarVectorEnv(load_env_creator(entry_point), num_envs, physics=physics, **arguments)


LidarEnvs = partial(_make, "lidarnaut.envs.core:LidarEnv")
ExploreFrontiersEnvs = partial(_make, "lidarnaut.envs.decisions.explore_frontiers:ExploreFrontiersEnv")
ExploreFrontiersAbstractEnvs = partial(_make, "lidarnaut.envs.decisions.abstract:ExploreFrontiersAbstractEnv")
ExploreTeamFrontiersEnvs = partial(_make, "lidarnaut.envs.decisions.explore_team_frontiers:ExploreTeamFrontiersEnv")

"""Gymnasium environments of lidar robots, registered in the namespace `lidarnaut` on import."""

from typing import Any

import gymnasium

LIDAR_ENV = "lidarnaut.envs.core:LidarEnv"
_TEAM_ENV = "lidarnaut.envs.decisions.explore_team_frontiers:ExploreTeamFrontiersEnv"
_REACH, _TRACK = "lidarnaut.envs.tasks.reach_goal:ReachGoal", "lidarnaut.envs.tasks.track:Track"
_DOCK, _SWEEP = "lidarnaut.envs.tasks.dock:Dock", "lidarnaut.envs.tasks.sweep:Sweep"
_EXPLORE = "lidarnaut.envs.tasks.explore:Explore"
_FROM_SPAWN = {"robot": "jackal", "start": "spawn", "goal": "world"}
_BARN = {"goal_tolerance": 1.0, "time_limit": 100.0}
ENVIRONMENTS: dict[str, tuple[str, dict[str, Any]]] = {
    "lidarnaut/Explore-v0": (LIDAR_ENV, {"task": _EXPLORE}),
    "lidarnaut/ExploreTurtleBot3World-v0": (LIDAR_ENV, {"task": _EXPLORE, "world": "turtlebot3_world"}),
    "lidarnaut/ExploreHouse-v0": (LIDAR_ENV, {"task": _EXPLORE, "world": "turtlebot3_house"}),
    "lidarnaut/ExploreWarehouse-v0": (LIDAR_ENV, {"task": _EXPLORE, "world": "tugbot_warehouse"}),
    "lidarnaut/ExploreRooms-v0": (LIDAR_ENV, {"task": _EXPLORE, "world": "rooms"}),
    "lidarnaut/ExploreMaze-v0": (LIDAR_ENV, {"task": _EXPLORE, "world": "maze"}),
    "lidarnaut/ExploreAisles-v0": (LIDAR_ENV, {"task": _EXPLORE, "world": "warehouse"}),
    "lidarnaut/ExploreCaves-v0": (LIDAR_ENV, {"task": _EXPLORE, "world": "caves"}),
    "lidarnaut/ExploreTeam-v0": (LIDAR_ENV, {"task": "lidarnaut.envs.tasks.explore:ExploreTeam"}),
    "lidarnaut/ExploreFrontiers-v0": ("lidarnaut.envs.decisions.explore_frontiers:ExploreFrontiersEnv", {}),
    "lidarnaut/ExploreTeamFrontiers-v0": (_TEAM_ENV, {}),
    "lidarnaut/ExploreFrontiersAbstract-v0": ("lidarnaut.envs.decisions.abstract:ExploreFrontiersAbstractEnv", {}),
    "lidarnaut/Navigate-v0": (LIDAR_ENV, {"task": "lidarnaut.envs.tasks.navigate:Navigate"}),
    "lidarnaut/Dock-v0": (LIDAR_ENV, {"task": _DOCK, "world": "tugbot_warehouse", "robot": "tugbot"}),
    "lidarnaut/Sweep-v0": (LIDAR_ENV, {"task": _SWEEP, "world": "aws_small_house", "robot": "create3"}),
    "lidarnaut/ReachGoal-v0": (LIDAR_ENV, {"task": _REACH}),
    "lidarnaut/ReachClutter-v0": (LIDAR_ENV, {"task": _REACH, "world": "clutter", **_FROM_SPAWN, **_BARN}),
    "lidarnaut/ReachCrowd-v0": (LIDAR_ENV, {"task": _REACH, "world": "hall", **_FROM_SPAWN, "people": "dense"}),
    "lidarnaut/ReachHouse-v0": (LIDAR_ENV, {"task": _REACH, "world": "turtlebot3_house", "min_distance": 5.0}),
    "lidarnaut/Track-v0": (LIDAR_ENV, {"task": _TRACK, "robot": "mpo_500", "control_hz": 17.0}),
}
"""Entry point and default arguments of each registered environment, by id."""


def register(id: str, task: Any, **defaults: Any) -> None:
    """Register a task for `gymnasium.make` and `gymnasium.make_vec`.

    Args:
        id: environment id, for example "my_lab/Escape-v0".
        task: subclass of `lidarnaut.envs.task.Task`, or `module:attribute` of one.
        defaults: default arguments of the environment.
    """
    _register(id, LIDAR_ENV, {"task": task, **defaults})


def _register(id: str, entry_point: str, arguments: dict[str, Any]) -> None:
    gymnasium.registry.pop(id, None)  # of an earlier import; Gymnasium would warn
    vector = f"lidarnaut.envs.vector:{entry_point.partition(':')[2]}s"
    gymnasium.register(id=id, entry_point=entry_point, vector_entry_point=vector, kwargs=arguments)


for _id, (_entry_point, _arguments) in ENVIRONMENTS.items():
    if _id not in gymnasium.registry:
        _register(_id, _entry_point, _arguments)

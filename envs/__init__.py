"""Lidarnaut: Gymnasium environments for robots that explore unknown places.

Importing this package registers the environments under the namespace `lidarnaut`.
"""

import gymnasium

_ENTRY_POINT = "envs.explore:ExploreEnv"
_FRONTIERS_ENTRY_POINT = "envs.explore_frontiers:ExploreFrontiersEnv"
_VECTOR_ENTRY_POINTS = {
    _ENTRY_POINT: "envs.explore_vector:ExploreVectorEnv",
    _FRONTIERS_ENTRY_POINT: "envs.explore_frontiers_vector:ExploreFrontiersVectorEnv",
}

_TABLE: dict[str, tuple[str, dict[str, object]]] = {
    "lidarnaut/Explore-v0": (_ENTRY_POINT, {}),
    "lidarnaut/ExploreTurtleBot3World-v0": (_ENTRY_POINT, {"world": "turtlebot3_world"}),
    "lidarnaut/ExploreHouse-v0": (_ENTRY_POINT, {"world": "turtlebot3_house"}),
    "lidarnaut/ExploreWarehouse-v0": (_ENTRY_POINT, {"world": "tugbot_warehouse"}),
    "lidarnaut/ExploreRooms-v0": (_ENTRY_POINT, {"world": "rooms"}),
    "lidarnaut/ExploreMaze-v0": (_ENTRY_POINT, {"world": "maze"}),
    "lidarnaut/ExploreAisles-v0": (_ENTRY_POINT, {"world": "warehouse"}),
    "lidarnaut/ExploreCaves-v0": (_ENTRY_POINT, {"world": "caves"}),
    "lidarnaut/ExploreFrontiers-v0": (_FRONTIERS_ENTRY_POINT, {}),
    "lidarnaut/ExploreTeam-v0": ("envs.explore_team:ExploreTeamEnv", {}),
    "lidarnaut/Navigate-v0": ("envs.navigate:NavigateEnv", {}),
    "lidarnaut/Track-v0": ("envs.track:TrackEnv", {}),
}

for _id, (_entry_point, _kwargs) in _TABLE.items():
    if _id not in gymnasium.registry:
        _vector = _VECTOR_ENTRY_POINTS.get(_entry_point)
        gymnasium.register(id=_id, entry_point=_entry_point, vector_entry_point=_vector, kwargs=_kwargs)

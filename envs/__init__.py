"""Lidarnaut: Gymnasium environments in which lidar robots explore unknown worlds.

Importing this package registers the environments under the namespace `lidarnaut`.
"""

import gymnasium

ENVIRONMENTS: dict[str, tuple[str, dict[str, object]]] = {
    "lidarnaut/Explore-v0": ("envs.explore:ExploreEnv", {}),
    "lidarnaut/ExploreTurtleBot3World-v0": ("envs.explore:ExploreEnv", {"world": "turtlebot3_world"}),
    "lidarnaut/ExploreHouse-v0": ("envs.explore:ExploreEnv", {"world": "turtlebot3_house"}),
    "lidarnaut/ExploreWarehouse-v0": ("envs.explore:ExploreEnv", {"world": "tugbot_warehouse"}),
    "lidarnaut/ExploreRooms-v0": ("envs.explore:ExploreEnv", {"world": "rooms"}),
    "lidarnaut/ExploreMaze-v0": ("envs.explore:ExploreEnv", {"world": "maze"}),
    "lidarnaut/ExploreAisles-v0": ("envs.explore:ExploreEnv", {"world": "warehouse"}),
    "lidarnaut/ExploreCaves-v0": ("envs.explore:ExploreEnv", {"world": "caves"}),
    "lidarnaut/ExploreFrontiers-v0": ("envs.explore_frontiers:ExploreFrontiersEnv", {}),
    "lidarnaut/ExploreFrontiersAbstract-v0": ("envs.abstract:ExploreFrontiersAbstractEnv", {}),
    "lidarnaut/ExploreTeam-v0": ("envs.explore_team:ExploreTeamEnv", {}),
    "lidarnaut/Navigate-v0": ("envs.navigate:NavigateEnv", {}),
    "lidarnaut/Track-v0": ("envs.track:TrackEnv", {}),
}
"""Environments: id -> class and arguments. Each also has a vector environment, `envs.vector`."""

for _id, (_entry_point, _kwargs) in ENVIRONMENTS.items():
    if _id not in gymnasium.registry:
        _vector = "envs.vector:" + _entry_point.partition(":")[2].replace("Env", "VectorEnv")
        gymnasium.register(id=_id, entry_point=_entry_point, vector_entry_point=_vector, kwargs=_kwargs)

"""Explore, save the map, localize from an unknown start pose, and drive to a goal.

`python -m lidarnaut.baselines.global_localization` does so with several goals and a film.
"""

from pathlib import Path

import tyro

from lidarnaut import LidarEnv, make_explorer, run_episode, save_map
from lidarnaut.envs.navigation import GoalNavigator, GoalParams, crop_to_known
from lidarnaut.envs.tasks.explore import Explore
from lidarnaut.envs.tasks.navigate import Navigate


def main(world: str = "turtlebot3_world", out: Path = Path("runs/localize_and_drive"), seed: int = 0) -> str:
    """Run the experiment and return how the drive to the goal ended.

    Args:
        world: World to explore.
        out: Folder of the map.
        seed: Seed of starts, noise and goal.
    """
    out.mkdir(parents=True, exist_ok=True)
    exploration = LidarEnv(Explore, world=world, physics="kinematic", start="spawn")
    episode = run_episode(exploration, make_explorer("nearest"), seed)
    # Format of ROS's map_server: map.pgm and map.yaml.
    map_path = save_map(crop_to_known(exploration.belief.grid, margin=5), out / "map.yaml")
    exploration.close()
    print(f"explored {100 * episode.explored_fraction:.0f} %; map in {map_path}")

    # The map frame is the start pose of the exploration; `map_pose` is its pose in the world frame.
    env = LidarEnv(
        Navigate, world=world, physics="kinematic", map=map_path, map_pose=exploration.map_pose, initial_pose="unknown"
    )
    driven = run_episode(env, GoalNavigator(GoalParams(lost_time=120.0)), seed + 1)
    env.close()
    print(
        f"goal {driven.history.of('geodesic_distance')[0]:.1f} m away: {driven.end_reason} in {driven.duration:.0f} s, "
        f"{driven.path_length:.1f} m (localization included); {driven.collisions:.0f} collisions"
    )
    return driven.end_reason


if __name__ == "__main__":
    tyro.cli(main)

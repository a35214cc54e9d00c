"""How often an explorer comes back to its start: `python -m benchmarks.return_home --worlds turtlebot3_house rooms`.

Map and pose come from the SLAM; only the distance to the start is measured by ground truth.
"""

from collections import Counter

import gymnasium
import numpy as np

import baselines
import envs  # noqa: F401  (registers the environments)
from baselines.episode import Info, run_episode
from envs.command_line import Count, run_command
from envs.slam import DEFAULT_SLAM
from envs.tasks.explore import HOME_RADIUS


def drive(explorer: str, world: str, physics: str, slam: str, seed: int) -> Info:
    """Let an explorer explore a world and return; return the last `info`."""
    env = gymnasium.make(
        "lidarnaut/Explore-v0", world=world, physics=physics, slam=slam, split="test", return_home=True
    )
    episode = run_episode(env, baselines.make_explorer(explorer), seed)
    env.close()
    return dict(episode.course.final)


def main(
    explorer: str = "gain_over_cost",
    worlds: tuple[str, ...] = ("turtlebot3_world", "turtlebot3_house", "rooms", "maze"),
    physics: str = "kinematic",
    slam: str = DEFAULT_SLAM,
    episodes: Count = 5,
) -> None:
    """Print a line per world.

    Args:
        explorer: name of a classic explorer.
        worlds: library worlds and procedural families.
        physics: kinematic or bullet.
        slam: SLAM in the loop.
        episodes: starts in each world, from seed 0 on.
    """
    print(f"{explorer}, {physics}, {slam}; returned: within {HOME_RADIUS} m of the start, by ground truth")
    for world in worlds:
        ends = [drive(explorer, world, physics, slam, seed) for seed in range(episodes)]
        returned = [info for info in ends if info["returned"]]
        errors = [float(info["pose_error"][0]) for info in ends]
        line = f"{world}: {len(returned)} of {episodes} returned"
        if returned:
            seconds = np.median([info["time_home"] for info in returned])
            share = np.median([info["time_home"] / info["time"] for info in returned])
            line += f", in {seconds:.0f} s, {share:.0%} of the time (medians)"
        line += f"; position error at the end {np.median(errors):.3f} m (median), {max(errors):.3f} m (worst)"
        others = Counter(info["end_reason"] for info in ends if not info["returned"])
        print(line, *(f"{count} {reason}" for reason, count in others.items()), sep="; ", flush=True)


if __name__ == "__main__":
    run_command(main)

"""Robot team as PettingZoo's `ParallelEnv`: agents "robot_0", "robot_1", ... with a shared map.

Install the extra first: `pip install -e ".[pettingzoo]"`.
"""

import numpy as np
import tyro

from lidarnaut.envs.wrappers.pettingzoo import TeamParallelEnv


def main(steps: int = 100, num_robots: int = 3) -> dict[str, float]:
    """Let each robot turn away from obstacles; return the total reward of each agent.

    Args:
        steps: Number of control periods.
        num_robots: Number of robots, up to four.
    """
    env = TeamParallelEnv(num_robots=num_robots, world="rooms", world_size=(10.0, 10.0), physics="kinematic")
    observations, _ = env.reset(seed=0)
    sums = dict.fromkeys(env.possible_agents, 0.0)
    for _ in range(steps):
        actions = {}
        for agent in env.agents:
            scan = observations[agent]["scan"]
            right, left = scan[120:180].mean(), scan[180:240].mean()
            actions[agent] = np.array([0.6, np.clip(2.0 * (left - right), -1.0, 1.0)], dtype=np.float32)
        observations, rewards, _, _, infos = env.step(actions)
        for agent, reward in rewards.items():
            sums[agent] += reward
        if not env.agents:
            break
    explored = next(iter(infos.values()))["explored_fraction"]
    env.close()
    print(f"explored {100 * explored:.0f} %; rewards {sums}")
    return sums


if __name__ == "__main__":
    tyro.cli(main)

"""Custom observation part: minimum range in each of eight sectors."""

import gymnasium
import numpy as np
import tyro
from gymnasium import spaces

import lidarnaut  # noqa: F401  (registers the environments)
from lidarnaut import RobotParams
from lidarnaut.envs.robot import Robot


class Sectors:
    """Minimum range in each of `count` sectors, relative to the maximum range; sector 0 begins behind the robot."""

    def __init__(self, count: int = 8) -> None:
        self._count = count

    def space(self, robot: RobotParams) -> spaces.Box:
        """Return the space of the observation part."""
        return spaces.Box(0.0, 1.0, (self._count,), np.float32)

    def write(self, robot: Robot, out: np.ndarray) -> None:
        """Write the observation to `out`, shape (count,), float32, from readings and estimates only."""
        ranges = np.nan_to_num(robot.reading.ranges / robot.params.lidar.range_max, nan=1.0, posinf=1.0)
        for k, part in enumerate(np.array_split(ranges, self._count)):
            out[k] = part.min()


def main(steps: int = 50) -> dict[str, np.ndarray]:
    """Turn away from obstacles by the sectors alone, and return the last observation."""
    # None selects a part of the package by name; "own_observation:Sectors" and objects work too.
    observations = {"motion": None, "sectors": Sectors}
    env = gymnasium.make("lidarnaut/ExploreTurtleBot3World-v0", observations=observations, physics="kinematic")
    observation, _ = env.reset(seed=0)
    for _ in range(steps):
        right, left = observation["sectors"][3], observation["sectors"][4]
        action = np.array([min(right, left), np.clip(2.0 * (left - right), -1.0, 1.0)], dtype=np.float32)
        observation, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            break
    env.close()
    print({name: np.round(values, 2).tolist() for name, values in observation.items()})
    return observation


if __name__ == "__main__":
    tyro.cli(main)

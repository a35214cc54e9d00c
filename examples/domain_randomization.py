"""Domain randomization: lidar, wheels and motors vary between episodes, unknown to the robot."""

import gymnasium
import numpy as np
import tyro

import lidarnaut  # noqa: F401  (registers the environments)
from lidarnaut import make_explorer, run_episode
from lidarnaut.envs.core import lidar_env_of
from lidarnaut.envs.robots import load_robot

ROBOT = load_robot("turtlebot3_burger")
RADIUS = ROBOT.drive.wheel_radius
RANGES = {
    "lidar.noise_std": (0.005, 0.03),
    "lidar.dropout": (0.0, 0.1),
    "lidar.mount.yaw": (-0.03, 0.03),
    "drive.wheel_radius": (0.95 * RADIUS, 1.05 * RADIUS),
    "drive.slip_std": (0.0, 0.01),
    "max_v": (0.18, 0.22),
}
"""Ranges of randomized parameters, in the units of `RobotParams`."""


def main(episodes: int = 4, seconds: float = 60.0) -> np.ndarray:
    """Explore with randomized robots.

    Args:
        episodes: Number of episodes.
        seconds: Simulated time per episode [s].

    Returns:
        Wheel radius [m] and RMSE of the estimated position [m] per episode, shape (episodes, 2).
    """
    env = gymnasium.make("lidarnaut/Explore-v0", robot=ROBOT, physics="kinematic", time_limit=seconds, randomize=RANGES)
    explorer, rows = make_explorer("nearest"), []
    for seed in range(episodes):
        episode = run_episode(env, explorer, seed)
        drawn = lidar_env_of(env).randomized
        print({name: round(value, 4) for name, value in drawn.items()})
        print(f"explored {100 * episode.explored_fraction:.0f} %, position off by {episode.position_rmse:.3f} m")
        rows.append((drawn["drive.wheel_radius"], episode.position_rmse))
    env.close()
    return np.array(rows)


if __name__ == "__main__":
    tyro.cli(main)

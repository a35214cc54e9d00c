"""Custom world, drawn with NumPy: occupied cells become walls.

`world=` takes a `World`, a file path, or a function that generates a world per episode.
"""

import gymnasium
import numpy as np
import tyro

import lidarnaut  # noqa: F401  (registers the environments)
from lidarnaut import make_policy, run_episode
from lidarnaut.envs.geometry import FREE, OCCUPIED, OccupancyGrid, Pose2D
from lidarnaut.envs.worlds import World, world_from_map

RESOLUTION = 0.1
"""Cell size [m]."""


def draw_world(rng: np.random.Generator) -> World:
    """Return a hall of 10 m x 6 m with a door in a wall and four random pillars; row 0 has the lowest y."""
    cells = np.full((60, 100), FREE, dtype=np.int8)
    cells[[0, -1], :] = OCCUPIED
    cells[:, [0, -1]] = OCCUPIED
    cells[:, 50:52] = OCCUPIED
    cells[25:37, 50:52] = FREE
    for row, col in rng.integers((8, 62), (48, 88), size=(4, 2)):
        cells[row : row + 4, col : col + 4] = OCCUPIED
    grid = OccupancyGrid(cells, RESOLUTION, (0.0, 0.0))
    return world_from_map(grid, "my_hall", spawn=Pose2D(2.0, 3.0, 0.0))


def main(seconds: float = 120.0) -> float:
    """Explore the world and return the explored fraction.

    Args:
        seconds: Simulated time [s].
    """
    env = gymnasium.make("lidarnaut/Explore-v0", world=draw_world, physics="kinematic", time_limit=seconds)
    episode = run_episode(env, make_policy("nearest"), seed=0)
    env.close()
    print(f"explored {100 * episode.explored_fraction:.0f} % of my_hall in {episode.duration:.0f} s")
    return episode.explored_fraction


if __name__ == "__main__":
    tyro.cli(main)

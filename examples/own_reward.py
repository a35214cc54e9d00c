"""Custom reward: changed weights, and terms computed from quantities of the step."""

from collections.abc import Mapping

import gymnasium
import numpy as np
import tyro

import lidarnaut  # noqa: F401  (registers the environments)
from lidarnaut.envs.task import Rewards


class Careful(Rewards):
    """Collisions cost ten times as much, gaps below 0.1 m 0.3 per s; exploration with larger gaps counts twice.

    Own terms are rates per second, as `close`; those in `per_step` are amounts of a step, as the explored area [m2].
    """

    changes = {"collision": -5.0, "yaw_rate": -0.02, "close": -0.3, "careful": 1.0}
    per_step = ("careful",)

    def terms(self, quantities: Mapping[str, float]) -> dict[str, float]:
        """Return the weighted terms of a step by name."""
        is_close = quantities["obstacle_gap"] < 0.1
        own = {"close": float(is_close), "careful": 0.0 if is_close else quantities["explored"]}
        return super().terms({**quantities, **own})


def main(steps: int = 100) -> dict[str, float]:
    """Drive ahead and return the sum of each term."""
    env = gymnasium.make("lidarnaut/ExploreTurtleBot3World-v0", reward=Careful, physics="kinematic")
    env.reset(seed=0)
    sums: dict[str, float] = {}
    for _ in range(steps):
        *_, terminated, truncated, info = env.step(np.array([0.8, 0.1], dtype=np.float32))
        for name, value in info["rewards"].items():
            sums[name] = sums.get(name, 0.0) + value
        if terminated or truncated:
            break
    env.close()
    print(", ".join(f"{name}: {value:.2f}" for name, value in sums.items()))
    return sums


if __name__ == "__main__":
    tyro.cli(main)

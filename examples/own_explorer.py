"""Custom policies: frontier rule, explorer with velocity commands, and policies of other libraries.

From this folder, `lidarnaut-evaluate --policies own_explorer:largest own_explorer:Circling own_explorer:Chooser nearest
--out DIR` compares them.
"""

import gymnasium
import numpy as np
import tyro

import lidarnaut  # noqa: F401  (registers the environments)
from lidarnaut import make_policy, run_episode
from lidarnaut.baselines import Explorer
from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.navigation import FEATURES, Candidates
from lidarnaut.envs.simulation import Reading, Twist


def largest(candidates: Candidates, belief: Belief) -> np.ndarray:
    """Score frontiers by size over travel cost; the navigator drives to the best."""
    return candidates["size"] / (1.0 + candidates["cost"])


class Circling(Explorer):
    """Explorer that drives in circles, wider in open space."""

    def act(self, reading: Reading, belief: Belief) -> Twist:
        """Return the twist for the next control period, without access to ground truth."""
        nearest = float(np.nanmin(reading.ranges))
        return Twist(0.5 * self.robot.max_v, self.robot.max_w / (1.0 + nearest))


def ahead(observation: dict[str, np.ndarray]) -> np.ndarray:
    """Velocity policy: return forward speed and yaw rate as fractions of the limits, clipped to [-1, 1]."""
    left, right = observation["scan"][60:120].mean(), observation["scan"][240:300].mean()
    return np.array([0.6, 2.0 * (left - right)])


class Chooser:
    """Frontier policy for `ExploreFrontiers-v0`, with the interface of sb3-contrib models."""

    level = "decision"

    def predict(self, observation: dict[str, np.ndarray], action_masks: np.ndarray) -> tuple[np.int64, None]:
        """Return the index of a candidate, and no state."""
        visible = observation["candidates"][:, FEATURES.index("visible")]
        return np.argmax(np.where(action_masks, visible, -1.0)), None


def main(seconds: float = 60.0) -> dict[str, float]:
    """Explore a world with each policy and return the explored fractions.

    Args:
        seconds: Simulated time [s].
    """
    policies = {"largest": largest, "circling": Circling, "ahead": ahead, "nearest": make_policy("nearest")}
    fractions = {}
    for name, policy in policies.items():
        env = gymnasium.make("lidarnaut/ExploreTurtleBot3World-v0", physics="kinematic", time_limit=seconds)
        fractions[name] = run_episode(env, policy, seed=0).explored_fraction
        env.close()
        print(f"{name}: explored {100 * fractions[name]:.0f} %")
    return fractions


if __name__ == "__main__":
    tyro.cli(main)

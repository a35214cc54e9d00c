"""Explorers of one's own: a rule over frontiers, and a class that steers by itself, against `nearest`.

`lidarnaut-evaluate --policies own_explorer:largest own_explorer:Circling nearest --out DIR`, from this folder, compares
them in full.
"""

import gymnasium
import numpy as np
import tyro

import envs  # noqa: F401  (registers the environments)
from baselines import make_explorer
from baselines.episode import run_episode
from baselines.frontier.explorer import RuleExplorer
from envs.estimation import Belief
from envs.navigation import Candidates
from envs.robots import RobotParams
from envs.simulation import Reading, Twist


def largest(candidates: Candidates, belief: Belief) -> int:
    """Return the index of the frontier with the most metres for its travel cost; the navigator drives there."""
    return int(np.argmax(candidates.sizes / (1.0 + candidates.costs)))


class Circling:
    """Drives in circles that widen with the space around the robot; decides the twist of each control period."""

    end_reason = None  # a text ends the episode
    plan = None  # a path, shape (n, 2), map frame [m], is drawn

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        """Prepare for an episode; all random draws come from `rng`."""
        self._robot = robot

    def act(self, reading: Reading, belief: Belief) -> Twist:
        """Return the twist for the next control period, from sensors and estimates; there is no ground truth."""
        nearest = float(np.nanmin(reading.ranges))
        return Twist(0.5 * self._robot.max_v, self._robot.max_w / (1.0 + nearest))


def main(seconds: float = 60.0) -> dict[str, float]:
    """Let three explorers explore the same world; return the explored fractions.

    Args:
        seconds: Simulated time.
    """
    explorers = {"largest": RuleExplorer(largest), "circling": Circling(), "nearest": make_explorer("nearest")}
    fractions = {}
    for name, explorer in explorers.items():
        env = gymnasium.make("lidarnaut/ExploreTurtleBot3World-v0", physics="kinematic", time_limit=seconds)
        fractions[name] = run_episode(env, explorer, seed=0).explored_fraction
        env.close()
        print(f"{name}: explored {100 * fractions[name]:.0f} %")
    return fractions


if __name__ == "__main__":
    tyro.cli(main)

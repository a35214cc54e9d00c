"""Custom algorithm: PPO with an entropy bonus that decays to zero.

From this folder, `lidarnaut-train --algorithm own_algorithm:FadingPPO --environment.id lidarnaut/ReachGoal-v0` trains
with any subclass of a stable-baselines3 algorithm. Constructor arguments are keys of `hyperparameters`.
"""

from pathlib import Path
from typing import Any

import tyro
from stable_baselines3 import PPO

from lidarnaut.agents.config import TrainingConfig
from lidarnaut.agents.explorer import LearnedPolicy
from lidarnaut.agents.training import train


class FadingPPO(PPO):
    """PPO with `ent_coef` equal to `first_ent_coef` times the remaining fraction of training."""

    def __init__(self, policy: Any, env: Any, first_ent_coef: float = 0.01, **arguments: Any) -> None:
        super().__init__(policy, env, **arguments)
        self._first_ent_coef = first_ent_coef

    def train(self) -> None:
        """Update the networks with the last rollout."""
        self.ent_coef = self._first_ent_coef * self._current_progress_remaining
        super().train()


def main(total_steps: int = 50_000, episodes: int = 20, out: Path | None = None) -> LearnedPolicy:
    """Train a policy to reach goals in unknown worlds, and return it.

    Args:
        total_steps: Steps of all sub-environments together.
        episodes: Episodes per evaluation.
        out: Run folder; None creates one in `runs/`.
    """
    config = TrainingConfig.model_validate(
        {
            "experiment": "fading",
            "algorithm": "own_algorithm:FadingPPO",
            "hyperparameters": {"first_ent_coef": 0.02, "n_steps": 64},
            "environment": {"id": "lidarnaut/ReachGoal-v0", "world": "halls", "physics": "kinematic"},
            "evaluation": {"episodes": episodes},
            "total_steps": total_steps,
        }
    )
    run = train(config, run=out)
    options = "--worlds halls --trust own_algorithm --out DIR"
    print(f"lidarnaut-evaluate --id lidarnaut/ReachGoal-v0 --policies learned:{run} pursuit {options}")
    return LearnedPolicy.load(run, trust=["own_algorithm"])


if __name__ == "__main__":
    tyro.cli(main)

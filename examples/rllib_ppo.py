"""RLlib's PPO.

RLlib 2.60 requires Gymnasium 1.2.2 and therefore a separate environment:

```sh
python3.11 -m venv .venv-libraries
.venv-libraries/bin/python -m pip install --editable . --requirement examples/requirements.txt
.venv-libraries/bin/python examples/rllib_ppo.py
```
"""

from typing import Any

import gymnasium
import ray
import tyro
from ray.rllib.algorithms.ppo import PPOConfig
from ray.tune.registry import register_env


def make_env(config: dict[str, Any]) -> gymnasium.Env:
    """Return an environment with a flat observation, for RLlib's worker processes."""
    import lidarnaut  # noqa: F401  (registers the environments)

    env = gymnasium.make("lidarnaut/ExploreRooms-v0", physics="kinematic", **config)
    return gymnasium.wrappers.FlattenObservation(env)


def main(total_timesteps: int = 20_000, batch_size: int = 4000, num_runners: int = 0) -> float:
    """Train and return the mean value loss of the last iteration.

    Args:
        total_timesteps: Total number of environment steps.
        batch_size: Environment steps per update.
        num_runners: Number of processes that step environments; 0 for this process.
    """
    register_env("lidarnaut", make_env)
    arguments = {
        "world_size": (8.0, 8.0),
        "control_hz": 5.0,
        "observations": ("scan", "motion"),
        "time_limit": 60.0,
        "clip_actions": True,  # Gaussian policies exceed [-1, 1]
    }
    config = (
        PPOConfig()
        .environment("lidarnaut", env_config=arguments)
        .env_runners(num_env_runners=num_runners)
        .training(train_batch_size=batch_size, minibatch_size=batch_size // 4, num_epochs=4, gamma=0.995)
        .debugging(seed=0)
    )
    ray.init(include_dashboard=False, num_cpus=max(num_runners, 1), ignore_reinit_error=True)
    algorithm = config.build_algo()
    loss = 0.0
    for _ in range(max(1, total_timesteps // batch_size)):
        result = algorithm.train()
        loss = float(result["learners"]["default_policy"]["vf_loss"])
        print(f"mean return: {result['env_runners'].get('episode_return_mean', float('nan')):.2f}")
    algorithm.stop()
    ray.shutdown()
    return loss


if __name__ == "__main__":
    tyro.cli(main)

"""PPO of stable-baselines3, and RecurrentPPO and MaskablePPO of sb3-contrib, on a vector environment.

PPO and RecurrentPPO (with an LSTM) learn velocity commands from scans and motions. MaskablePPO learns to choose
frontiers in the fast abstract simulator; the navigator drives. `train.py` adds configuration files, checkpoints and
evaluations.
"""

import importlib
from pathlib import Path
from typing import Any, Literal

import gymnasium
import numpy as np
import tyro
from gymnasium.vector import AutoresetMode

import lidarnaut  # noqa: F401  (registers the environments)
from lidarnaut import run_episode
from lidarnaut.agents.vec_env import GymnasiumVecEnv  # before torch: reduces CPU use of its idle threads


def main(
    algorithm: Literal["PPO", "RecurrentPPO", "MaskablePPO"] = "PPO",
    total_timesteps: int = 100_000,
    num_envs: int = 16,
    num_steps: int = 128,
    seconds: float = 90.0,
    num_tests: int = 20,
    seed: int = 0,
    out: Path = Path("runs/sb3_ppo"),
) -> float:
    """Train and return the mean explored fraction of test worlds.

    Args:
        algorithm: Name of the algorithm.
        total_timesteps: Steps of all sub-environments together.
        num_envs: Number of sub-environments.
        num_steps: Steps per sub-environment and update.
        seconds: Duration of an episode [s].
        num_tests: Number of test worlds.
        seed: Seed of the training.
        out: File of the policy.
    """
    arguments: dict[str, Any] = {"world": "rooms", "world_size": (8.0, 8.0), "time_limit": seconds}
    if algorithm == "MaskablePPO":
        train_id, test_id = "lidarnaut/ExploreFrontiersAbstract-v0", "lidarnaut/ExploreFrontiers-v0"
        arguments |= {"max_candidates": 16}
    else:
        train_id = test_id = "lidarnaut/Explore-v0"
        arguments |= {"control_hz": 5.0, "observations": ("scan", "motion")}
    # stable-baselines3 expects the first observation of the next episode in the step that ends an episode.
    vector = gymnasium.make_vec(train_id, num_envs, autoreset_mode=AutoresetMode.SAME_STEP, **arguments)
    env = GymnasiumVecEnv(vector)  # also provides `action_masks`
    env.seed(seed)
    library = importlib.import_module("stable_baselines3" if algorithm == "PPO" else "sb3_contrib")
    policy = "MultiInputLstmPolicy" if algorithm == "RecurrentPPO" else "MultiInputPolicy"
    batch_size = num_envs * num_steps // 4
    model = getattr(library, algorithm)(policy, env, n_steps=num_steps, batch_size=batch_size, gamma=0.995, seed=seed)
    model.learn(total_timesteps)
    model.save(out)
    env.close()

    test = gymnasium.make(test_id, split="test", physics="kinematic", **arguments)
    explored = [run_episode(test, model, seed=k).explored_fraction for k in range(num_tests)]
    test.close()
    print(f"explored {100 * np.mean(explored):.0f} % of {num_tests} test worlds in {seconds:.0f} s each")
    return float(np.mean(explored))


if __name__ == "__main__":
    tyro.cli(main)

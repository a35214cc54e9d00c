"""RecurrentPPO of sb3-contrib: an LSTM over scans and motions alone, which has to remember where it was."""

from pathlib import Path

import gymnasium
import numpy as np
import tyro
from gymnasium.vector import AutoresetMode

import envs  # noqa: F401  (registers the environments)
from agents.vec_env import GymnasiumVecEnv  # imported before torch, whose idle threads it tells to sleep
from sb3_contrib import RecurrentPPO


def main(
    total_timesteps: int = 60_000,
    num_envs: int = 16,
    num_steps: int = 128,
    seconds: float = 90.0,
    out: Path = Path("runs/recurrent_ppo"),
) -> float:
    """Train; return the explored fraction in a test world.

    Args:
        total_timesteps: Steps of all sub-environments together.
        num_envs: Sub-environments.
        num_steps: Steps of each between two updates.
        seconds: Length of an episode [s].
        out: Where the policy goes.
    """
    arguments = {"control_hz": 5.0, "world_size": (8.0, 8.0), "observations": ("scan", "motion"), "time_limit": seconds}
    vector = gymnasium.make_vec(
        "lidarnaut/ExploreRooms-v0", num_envs, autoreset_mode=AutoresetMode.SAME_STEP, **arguments
    )
    env = GymnasiumVecEnv(vector)
    env.seed(0)
    policy = {"lstm_hidden_size": 64, "n_lstm_layers": 1}
    batch_size = num_envs * num_steps // 4
    model = RecurrentPPO(
        "MultiInputLstmPolicy", env, n_steps=num_steps, batch_size=batch_size, policy_kwargs=policy, seed=0
    )
    model.learn(total_timesteps)
    model.save(out)
    env.close()

    test = gymnasium.make("lidarnaut/ExploreRooms-v0", split="test", physics="kinematic", **arguments)
    observation, info = test.reset(seed=0)
    state, done = None, False
    while not done:
        is_first = np.array([state is None])
        action, state = model.predict(observation, state, episode_start=is_first, deterministic=True)
        observation, _, terminated, truncated, info = test.step(action)
        done = terminated or truncated
    test.close()
    print(f"explored {100 * info['explored_fraction']:.0f} % of a test world in {info['time']:.0f} s")
    return info["explored_fraction"]


if __name__ == "__main__":
    tyro.cli(main)

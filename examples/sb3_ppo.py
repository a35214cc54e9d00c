"""PPO of stable-baselines3 on a vector environment: a policy of twists.

`train.py` does the same with configuration files, checkpoints and evaluations.
"""

from pathlib import Path

import gymnasium
import tyro
from gymnasium.vector import AutoresetMode

import envs  # noqa: F401  (registers the environments)
from agents.vec_env import GymnasiumVecEnv  # imported before torch, whose idle threads it tells to sleep
from stable_baselines3 import PPO


def main(
    total_timesteps: int = 200_000,
    num_envs: int = 32,
    num_steps: int = 128,
    seconds: float = 90.0,
    out: Path = Path("runs/sb3_ppo"),
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
    # stable-baselines3 expects the observation of the next episode in the step that ends one.
    vector = gymnasium.make_vec(
        "lidarnaut/ExploreRooms-v0", num_envs, autoreset_mode=AutoresetMode.SAME_STEP, **arguments
    )
    env = GymnasiumVecEnv(vector)
    env.seed(0)
    batch_size = num_envs * num_steps // 4
    model = PPO("MultiInputPolicy", env, n_steps=num_steps, batch_size=batch_size, gamma=0.995, ent_coef=0.001, seed=0)
    model.learn(total_timesteps)
    model.save(out)
    env.close()

    test = gymnasium.make("lidarnaut/ExploreRooms-v0", split="test", physics="kinematic", **arguments)
    observation, info = test.reset(seed=0)
    done = False
    while not done:
        action, _ = model.predict(observation, deterministic=True)
        observation, _, terminated, truncated, info = test.step(action)
        done = terminated or truncated
    test.close()
    print(f"explored {100 * info['explored_fraction']:.0f} % of a test world in {info['time']:.0f} s")
    return info["explored_fraction"]


if __name__ == "__main__":
    tyro.cli(main)

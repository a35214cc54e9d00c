"""MaskablePPO of sb3-contrib at the decision level: an action picks a frontier, and the navigator drives there.

Trains in the abstract simulator, which is faster, and tries the policy in the environment with sensors and SLAM.
"""

from pathlib import Path

import gymnasium
import tyro
from gymnasium.vector import AutoresetMode

import envs  # noqa: F401  (registers the environments)
from agents.vec_env import GymnasiumVecEnv  # imported before torch, whose idle threads it tells to sleep
from sb3_contrib import MaskablePPO


def main(
    total_timesteps: int = 60_000,
    num_envs: int = 16,
    num_steps: int = 64,
    seconds: float = 120.0,
    out: Path = Path("runs/maskable_ppo"),
) -> float:
    """Train; return the explored fraction in a test world.

    Args:
        total_timesteps: Decisions of all sub-environments together.
        num_envs: Sub-environments.
        num_steps: Decisions of each between two updates.
        seconds: Length of an episode [s].
        out: Where the policy goes.
    """
    arguments = {"world": "rooms", "world_size": (10.0, 10.0), "max_candidates": 16, "time_limit": seconds}
    vector = gymnasium.make_vec(
        "lidarnaut/ExploreFrontiersAbstract-v0", num_envs, autoreset_mode=AutoresetMode.SAME_STEP, **arguments
    )
    env = GymnasiumVecEnv(vector)  # answers `action_masks` from the latest observations
    env.seed(0)
    batch_size = num_envs * num_steps // 4
    model = MaskablePPO("MultiInputPolicy", env, n_steps=num_steps, batch_size=batch_size, gamma=0.99, seed=0)
    model.learn(total_timesteps)
    model.save(out)
    env.close()

    test = gymnasium.make("lidarnaut/ExploreFrontiers-v0", split="test", physics="kinematic", **arguments)
    observation, info = test.reset(seed=0)
    done = False
    while not done:
        action, _ = model.predict(observation, action_masks=info["action_mask"], deterministic=True)
        observation, _, terminated, truncated, info = test.step(action)
        done = terminated or truncated
    test.close()
    print(f"explored {100 * info['explored_fraction']:.0f} % of a test world in {info['time']:.0f} s")
    return info["explored_fraction"]


if __name__ == "__main__":
    tyro.cli(main)

"""Single-file PPO after CleanRL (Huang et al., 2022), for both autoreset modes of Gymnasium.

NEXT_STEP (Gymnasium's default): the step after an episode ends is a reset, and is not trained on. SAME_STEP: the step
that ends an episode also resets; `info["final_obs"]` holds the last observation. A truncated episode is bootstrapped
with the value of its last observation; CleanRL uses 0.
"""

import gymnasium
import numpy as np
import tyro
from gymnasium.vector import AutoresetMode

import lidarnaut.agents  # noqa: F401  (registers the environments; idle threads of torch sleep, if before torch)
import torch
from torch.distributions import Normal

GAMMA, LAMBDA, CLIP = 0.995, 0.95, 0.2


def flat(observation: dict[str, np.ndarray]) -> torch.Tensor:
    """Return scan and motion as one vector, shape (..., num_inputs), float32."""
    return torch.as_tensor(np.concatenate([observation["scan"], observation["motion"]], axis=-1))


def main(
    total_timesteps: int = 300_000,
    num_envs: int = 32,
    num_steps: int = 128,
    seconds: float = 60.0,
    mode: AutoresetMode = AutoresetMode.NEXT_STEP,
) -> list[float]:
    """Train; return the mean reward per step of each iteration."""
    torch.manual_seed(0)
    arguments = {"world_size": (8.0, 8.0), "control_hz": 5.0, "observations": ("scan", "motion"), "time_limit": seconds}
    venv = gymnasium.make_vec("lidarnaut/ExploreRooms-v0", num_envs, autoreset_mode=mode, **arguments)
    obs, means = flat(venv.reset(seed=0)[0]), []
    layers = [(torch.nn.Linear(obs.shape[1], 64), torch.nn.Tanh(), torch.nn.Linear(64, n)) for n in (2, 1)]
    actor, critic = (torch.nn.Sequential(*each) for each in layers)
    log_std = torch.nn.Parameter(torch.zeros(2))
    optimizer = torch.optim.Adam([*actor.parameters(), *critic.parameters(), log_std], lr=3e-4)
    is_reset = torch.zeros(num_envs, dtype=torch.bool)  # True if the next step only resets
    for _ in range(total_timesteps // (num_envs * num_steps)):
        rows = []
        with torch.no_grad():
            for _ in range(num_steps):
                policy = Normal(actor(obs), log_std.exp())
                action = policy.sample()
                after, reward, terminated, truncated, info = venv.step(action.clamp(-1.0, 1.0).numpy())
                done, last = torch.as_tensor(terminated | truncated), flat(after)
                for i in np.flatnonzero(info.get("_final_obs", ())):  # SAME_STEP only
                    last[i] = flat(info["final_obs"][i])
                reward = torch.as_tensor(reward, dtype=torch.float32)
                delta = reward + GAMMA * critic(last)[:, 0] * ~torch.as_tensor(terminated) - critic(obs)[:, 0]
                rows.append((obs, action, policy.log_prob(action).sum(-1), delta, reward, done, ~is_reset))
                obs, is_reset = flat(after), done & (mode == AutoresetMode.NEXT_STEP)
            observations, actions, log_probs, deltas, rewards, dones, valid = (torch.stack(each) for each in zip(*rows))
            advantages = torch.zeros(num_steps + 1, num_envs)  # generalized advantage estimation
            for t in reversed(range(num_steps)):
                advantages[t] = torch.where(valid[t], deltas[t] + GAMMA * LAMBDA * advantages[t + 1] * ~dones[t], 0.0)
            returns = advantages[:-1] + critic(observations)[..., 0]
        data = [column[valid] for column in (observations, actions, log_probs, advantages[:-1], returns)]
        for batch in [part for _ in range(4) for part in torch.randperm(len(data[0])).chunk(4)]:
            o, a, old_log_prob, gain, value = (column[batch] for column in data)
            gain = (gain - gain.mean()) / (gain.std() + 1e-8)
            policy = Normal(actor(o), log_std.exp())
            ratio = (policy.log_prob(a).sum(-1) - old_log_prob).exp()
            surrogate = torch.minimum(ratio * gain, ratio.clamp(1 - CLIP, 1 + CLIP) * gain).mean()
            loss = 0.5 * (critic(o)[:, 0] - value).square().mean() - surrogate - 0.001 * policy.entropy().sum(-1).mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
        means.append(float(rewards.mean()))
        print(f"mean reward per step: {means[-1]:.3f}")
    venv.close()
    return means


if __name__ == "__main__":
    tyro.cli(main)

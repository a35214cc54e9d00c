"""Trainings of `reach_scans` as written without this package: same task, rollout, minibatches and epochs."""

import importlib
from collections.abc import Iterator
from functools import partial
from typing import Any

import gymnasium

ID, PARTS = "lidarnaut:lidarnaut/ReachGoal-v0", ("scan_history", "goal", "motion")
ROLLOUT, BATCH, EPOCHS = 32_768, 512, 4


def make(is_flat: bool = False) -> gymnasium.Env:
    """Return the environment of `reach_scans`."""
    env = gymnasium.make(ID, observations=PARTS, physics="kinematic")
    return gymnasium.wrappers.FlattenObservation(env) if is_flat else env


def train_by(library: str, kind: str, num_envs: int) -> Iterator[int]:
    """Train by PPO of stable-baselines3 or sbx on its own vector environment; yield the steps of each rollout."""
    from stable_baselines3.common import vec_env
    from stable_baselines3.common.monitor import Monitor

    algorithm, is_flat = importlib.import_module(library).PPO, library == "sbx"  # sbx takes vectors only
    options: dict[str, Any] = {"start_method": "spawn"} if kind == "SubprocVecEnv" else {}
    env = getattr(vec_env, kind)([lambda: Monitor(make(is_flat))] * num_envs, **options)
    policy = "MlpPolicy" if is_flat else "MultiInputPolicy"
    model = algorithm(policy, env, n_steps=ROLLOUT // num_envs, batch_size=BATCH, n_epochs=EPOCHS, device="cpu")
    try:
        while True:
            model.learn(ROLLOUT, reset_num_timesteps=False)
            yield ROLLOUT
    finally:
        env.close()


def train_in_one_file(num_envs: int) -> Iterator[int]:
    """Train by PPO in one file, as CleanRL's (Huang et al., 2022), on Gymnasium's `SyncVectorEnv`."""
    import torch
    from torch import nn
    from torch.distributions import Normal

    vector = gymnasium.vector.SyncVectorEnv([partial(make, is_flat=True)] * num_envs)
    width = vector.single_observation_space.shape[0]  # type: ignore[index]
    critic, actor = (
        nn.Sequential(nn.Linear(width, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, n)) for n in (1, 2)
    )
    log_std = nn.Parameter(torch.zeros(2))
    weights = [*actor.parameters(), *critic.parameters(), log_std]
    optimizer = torch.optim.Adam(weights, lr=3e-4, eps=1e-5)
    seen = torch.as_tensor(vector.reset(seed=0)[0])
    while True:
        rows = []
        for _ in range(ROLLOUT // num_envs):
            with torch.no_grad():
                policy = Normal(actor(seen), log_std.exp())
                action = policy.sample()
                row = seen, action, policy.log_prob(action).sum(1), critic(seen)[:, 0]
            after, reward, terminated, truncated, _ = vector.step(action.clamp(-1.0, 1.0).numpy())
            rows.append((*row, torch.as_tensor(reward).float(), torch.as_tensor(terminated | truncated).float()))
            seen = torch.as_tensor(after)
        observations, actions, log_probs, values, rewards, dones = map(torch.stack, zip(*rows))
        with torch.no_grad():
            following, advantages, last = critic(seen)[:, 0], torch.zeros_like(rewards), torch.zeros(num_envs)
            for t in reversed(range(len(rows))):
                delta = rewards[t] + 0.99 * (1 - dones[t]) * following - values[t]
                advantages[t] = last = delta + 0.99 * 0.95 * (1 - dones[t]) * last
                following = values[t]
        columns = observations, actions, log_probs, advantages, advantages + values
        data = [column.flatten(0, 1) for column in columns]
        for batch in [part for _ in range(EPOCHS) for part in torch.randperm(ROLLOUT).split(BATCH)]:
            o, a, old, gain, target = (column[batch] for column in data)
            gain = (gain - gain.mean()) / (gain.std() + 1e-8)
            policy = Normal(actor(o), log_std.exp())
            ratio = (policy.log_prob(a).sum(1) - old).exp()
            surrogate = torch.minimum(ratio * gain, ratio.clamp(0.8, 1.2) * gain).mean()
            loss = 0.5 * (critic(o)[:, 0] - target).square().mean() - surrogate
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(weights, 0.5)
            optimizer.step()
        yield ROLLOUT

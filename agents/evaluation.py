"""How well a policy explores worlds that it was not trained on, measured while it trains."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import gymnasium
import numpy as np
from stable_baselines3.common.policies import ActorCriticPolicy

from agents.config import TrainingConfig
from agents.lanes import Observations, make_environment, stack
from agents.ppo import mean_action
from baselines.episode import run_episode
from baselines.explorer import Explorer

MAX_LANES = 10
"""Environments that an evaluation runs side by side, for the sake of batched network passes."""


@dataclass(frozen=True, slots=True)
class Episode:
    """What one episode came to."""

    explored_fraction: float
    """At the end, of the explorable area."""
    explored_area: float
    """At the end [m2]."""
    gained_area: float
    """Explored beyond what the very first scan showed [m2]."""
    area_under_curve: float
    """Mean explored fraction over the whole time limit; after an early end the last value holds."""
    path_length: float
    """Way driven [m]."""
    collisions: float
    """Contacts."""
    success: float
    """1 if the target coverage was reached, else 0."""


class Evaluator:
    """Runs the same episodes, on worlds of the test split, for whoever is to be measured."""

    def __init__(self, config: TrainingConfig) -> None:
        self._seeds = range(config.evaluation.episodes)
        lanes = min(config.evaluation.episodes, MAX_LANES)
        self._envs = [make_environment(config.environment, "test") for _ in range(lanes)]

    def close(self) -> None:
        """Close the environments."""
        for env in self._envs:
            env.close()

    def policy(self, policy: ActorCriticPolicy) -> list[Episode]:
        """Measure a policy's mean action; draws nothing from the global generators."""
        policy.set_training_mode(False)
        return run_episodes(self._envs, lambda seen: np.clip(mean_action(policy, seen), -1.0, 1.0), self._seeds)

    def explorer(self, name: str) -> list[Episode]:
        """Measure an explorer that does not learn."""
        from baselines import make_explorer  # brings scikit-learn, which a training without references need not load

        return [run_explorer(self._envs[0], make_explorer(name), seed) for seed in self._seeds]


def run_episodes(
    envs: Sequence[gymnasium.Env], act: Callable[[Observations], np.ndarray], seeds: Sequence[int]
) -> list[Episode]:
    """Run an episode per seed, as many at once as there are environments.

    Args:
        envs: environments of one kind.
        act: gives the actions, shape (batch, num_actions), for a batch of observations.
        seeds: passed to `reset`.

    Returns:
        The episodes in the order of `seeds`.
    """
    episodes: dict[int, Episode] = {}
    waiting = list(reversed(seeds))
    running = [_Running(env, waiting.pop()) for env in envs[: len(seeds)]]
    while running:
        actions = act(stack([lane.observation for lane in running]))
        for lane, action in zip(list(running), actions, strict=True):
            episode = lane.step(action)
            if episode is None:
                continue
            episodes[lane.seed] = episode
            running.remove(lane)
            if waiting:
                running.append(_Running(lane.env, waiting.pop()))
    return [episodes[seed] for seed in seeds]


def run_explorer(env: gymnasium.Env, explorer: Explorer, seed: int) -> Episode:
    """Run one episode with an explorer that sees observations and beliefs."""
    episode = run_episode(env, explorer, seed)
    area = env.unwrapped.coverage.area.area  # type: ignore[attr-defined]
    return Episode(
        explored_fraction=episode.explored_fraction,
        explored_area=episode.explored_fraction * area,
        gained_area=(episode.explored_fraction - float(episode.curve.explored_fraction[0])) * area,
        area_under_curve=episode.area_under_curve,
        path_length=episode.path_length,
        collisions=float(episode.collisions),
        success=float(episode.success),
    )


def summarise(episodes: Sequence[Episode]) -> dict[str, float]:
    """Return the means over episodes, and the quartiles of the explored fraction."""
    fractions = [episode.explored_fraction for episode in episodes]
    summary = {"episodes": float(len(episodes))}
    summary |= {name: float(np.mean([getattr(episode, name) for episode in episodes])) for name in Episode.__slots__}
    for name, q in (("q25", 0.25), ("q75", 0.75)):
        summary[f"explored_fraction_{name}"] = float(np.quantile(fractions, q))
    return summary


class _Running:
    """An episode under way."""

    def __init__(self, env: gymnasium.Env, seed: int) -> None:
        self.env = env
        self.seed = seed
        self.observation, info = env.reset(seed=seed)
        self._first_area = float(info["explored_area"])
        self._time_limit = float(env.unwrapped.time_limit)  # type: ignore[attr-defined]
        self._last_time = 0.0
        self._integral = 0.0

    def step(self, action: np.ndarray) -> Episode | None:
        """Take a step; return the episode once it has ended."""
        self.observation, _, terminated, truncated, info = self.env.step(action)
        fraction, time = float(info["explored_fraction"]), float(info["time"])
        self._integral += fraction * (time - self._last_time)
        self._last_time = time
        if not (terminated or truncated):
            return None
        return Episode(
            explored_fraction=fraction,
            explored_area=float(info["explored_area"]),
            gained_area=float(info["explored_area"]) - self._first_area,
            area_under_curve=(self._integral + fraction * max(self._time_limit - time, 0.0)) / self._time_limit,
            path_length=float(info["path_length"]),
            collisions=float(info["collisions"]),
            success=float(info["is_success"]),
        )

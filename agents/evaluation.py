"""How well a policy explores worlds that it was not trained on, measured while it trains."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from gymnasium.vector import VectorEnv
from stable_baselines3.common.policies import ActorCriticPolicy

from agents.config import TrainingConfig
from agents.policies import make_policy
from agents.ppo import mean_action
from agents.vec_env import Observations, make_env, make_vector
from baselines.episode import run_episode
from envs.explore import ExploreEnv
from envs.files import resolve

ELAPSED = 5
"""Index in the observation `motion` of the share of the time limit that has passed."""


@dataclass(frozen=True, slots=True)
class Episode:
    """The measures of one episode."""

    explored_fraction: float
    """At the end, of the explorable area."""
    explored_area: float
    """At the end [m2]."""
    gained_area: float
    """Explored beyond what the very first scan showed [m2]."""
    area_under_curve: float
    """Mean explored fraction over the whole time limit; after an early end the last value holds."""
    path_length: float
    """Distance driven [m]."""
    collisions: float
    """Contacts."""
    success: float
    """1 if the target coverage was reached, else 0."""


class Evaluator:
    """Runs the same episodes, on worlds of the test split, for policies and explorers alike."""

    def __init__(self, config: TrainingConfig) -> None:
        self._config = config
        # An episode of evaluation has an environment of its own; for that many, processes would be too heavy.
        sync = {"vectorization": "sync"} if config.environment.vectorization == "async" else {}
        environment = config.environment.model_copy(update=sync)
        self._vector = make_vector(environment, "test", config.evaluation.episodes)

    def close(self) -> None:
        """Close the environments."""
        self._vector.close()

    def policy(self, policy: ActorCriticPolicy) -> list[Episode]:
        """Measure a policy's mean action; draws nothing from the global generators."""
        policy.set_training_mode(False)
        return run_episodes(self._vector, lambda seen: np.clip(mean_action(policy, seen), -1.0, 1.0))

    def explorer(self, name: str) -> list[Episode]:
        """Measure an explorer that does not learn, by name or as `module:attribute`."""
        from baselines import EXPLORERS  # brings scikit-learn, which a training without references need not load

        env, source = make_env(self._config.environment, "test"), resolve(name, EXPLORERS, "explorer")
        episodes = []
        for seed in range(self._config.evaluation.episodes):
            episode = run_episode(env, make_policy(source, env.action_space), seed)
            area = cast(ExploreEnv, env.unwrapped).coverage.area.area
            gained = (episode.explored_fraction - float(episode.curve.explored_fraction[0])) * area
            names = ("explored_fraction", "area_under_curve", "path_length", "collisions", "success")
            measures = {name: float(getattr(episode, name)) for name in names}
            episodes.append(Episode(explored_area=episode.explored_fraction * area, gained_area=gained, **measures))
        env.close()
        return episodes


def run_episodes(
    vector: VectorEnv[Observations, np.ndarray, np.ndarray], act: Callable[[Observations], np.ndarray]
) -> list[Episode]:
    """Run one episode in each environment, environment i seeded with i.

    Args:
        vector: environments that reset in the same step; those that end early are stepped on, and ignored.
        act: gives the actions, shape (num_envs, num_actions), for a batch of observations.

    Returns:
        The episodes by environment.
    """
    observations, info = vector.reset(seed=0)  # environment i gets seed 0 + i
    first_area = np.array(info["explored_area"])
    episodes: dict[int, Episode] = {}
    integral, elapsed = np.zeros(vector.num_envs), np.zeros(vector.num_envs)
    while len(episodes) < vector.num_envs:
        observations, _, terminated, truncated, info = vector.step(act(observations))
        fractions, now = np.array(info["explored_fraction"]), observations["motion"][:, ELAPSED].astype(np.float64)
        done = np.flatnonzero(np.asarray(terminated) | np.asarray(truncated)).tolist()
        for i in done:
            fractions[i] = info["final_info"]["explored_fraction"][i]
            now[i] = info["final_obs"][i]["motion"][ELAPSED]
        integral += fractions * (now - elapsed)
        elapsed = now
        for i in set(done) - episodes.keys():
            names = ("explored_fraction", "explored_area", "path_length", "collisions", "is_success")
            final = {name: float(info["final_info"][name][i]) for name in names}
            episodes[i] = Episode(
                success=final.pop("is_success"),
                gained_area=final["explored_area"] - float(first_area[i]),
                area_under_curve=float(integral[i] + fractions[i] * (1.0 - now[i])),
                **final,
            )
    return [episodes[i] for i in range(vector.num_envs)]


def summarise(episodes: Sequence[Episode]) -> dict[str, float]:
    """Return the means over episodes, and the quartiles of the explored fraction."""
    columns = {name: [getattr(episode, name) for episode in episodes] for name in Episode.__slots__}
    summary = {"episodes": float(len(episodes))} | {name: float(np.mean(column)) for name, column in columns.items()}
    quartiles = {"q25": 0.25, "q75": 0.75}.items()
    return summary | {
        f"explored_fraction_{name}": float(np.quantile(columns["explored_fraction"], q)) for name, q in quartiles
    }

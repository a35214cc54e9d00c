"""How well a policy explores worlds that it was not trained on, measured while it trains."""

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import VectorEnv
from stable_baselines3.common.policies import ActorCriticPolicy

from agents.config import TrainingConfig
from agents.policies import make_policy
from agents.ppo import mean_action
from agents.vec_env import Observations, make_env, make_vector
from baselines.episode import run_episode
from baselines.explorer import Policy
from envs.core import lidar_env_of
from envs.files import resolve
from envs.measures import first_at


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
    time_to_target: float
    """Until the target coverage, or the time limit if it was not reached [s]."""


class Evaluator:
    """Runs the same episodes, on worlds of the test split, for policies and explorers alike."""

    def __init__(self, config: TrainingConfig) -> None:
        self._config = config
        changes: dict[str, object] = {}
        if config.evaluation.world is not None:
            changes = {"world": config.evaluation.world, "world_size": None}
        self._environment = config.environment.model_copy(update=changes)
        # An episode of evaluation has an environment of its own; for that many, processes would be too heavy.
        sync = {"vectorization": "sync"} if config.environment.vectorization == "async" else {}
        environment = self._environment.model_copy(update=sync)
        self._vector = make_vector(environment, "test", config.evaluation.episodes)
        self._chooses = isinstance(self._vector.single_action_space, spaces.Discrete)

    def close(self) -> None:
        """Close the environments."""
        self._vector.close()

    def policy(self, policy: ActorCriticPolicy) -> list[Episode]:
        """Measure a policy's most likely actions; draws nothing from the global generators."""
        policy.set_training_mode(False)
        if self._chooses:
            return run_episodes(self._vector, lambda seen: mean_action(policy, seen))
        return run_episodes(self._vector, lambda seen: np.clip(mean_action(policy, seen), -1.0, 1.0))

    def check(self, names: Sequence[str]) -> None:
        """See that explorers can be measured, before any work; raises as `explorer`."""
        for name in names:
            with contextlib.closing(make_env(self._environment, "test")) as env:
                self._make(name, env)

    def explorer(self, name: str) -> list[Episode]:
        """Measure an explorer that does not learn, by name or as `module:attribute`.

        Raises:
            ValueError: if there is none of this name, or it cannot choose frontiers where that is asked for.
        """
        env = make_env(self._environment, "test")
        episodes: list[Episode] = []
        for seed in range(self._config.evaluation.episodes):
            explorer = self._make(name, env)
            episode = run_episode(env, explorer, seed)
            task: Any = lidar_env_of(env).task
            area, fraction = task.coverage.area.area, episode.course.of("explored_fraction")
            gained = (episode.explored_fraction - float(fraction[0])) * area
            names = ("explored_fraction", "area_under_curve", "path_length", "collisions", "success")
            measures = {name: float(getattr(episode, name)) for name in names}
            measures |= {"explored_area": episode.explored_fraction * area, "gained_area": gained}
            time = min(first_at(episode.course.of("time"), fraction, task.target_coverage), episode.time_limit)
            episodes.append(Episode(time_to_target=time, **measures))
        env.close()
        return episodes

    def _make(self, name: str, env: gymnasium.Env[Any, Any]) -> Policy:
        # These bring scikit-learn, which a training without references need not load.
        from agents.frontiers.rules import make_reference
        from baselines import EXPLORERS

        source = resolve(name, EXPLORERS, "explorer")
        return make_reference(name, env) if self._chooses else make_policy(source, env.action_space)


def run_episodes(
    vector: VectorEnv[Observations, np.ndarray, np.ndarray], act: Callable[[Observations], np.ndarray]
) -> list[Episode]:
    """Run one episode in each environment, environment i seeded with i.

    Args:
        vector: environments that reset in the same step; those that end early are stepped on, and ignored.
        act: gives the actions for a batch of observations: shape (num_envs, num_actions), or (num_envs,) of choices.

    Returns:
        The episodes by environment.
    """
    observations, info = vector.reset(seed=0)  # environment i gets seed 0 + i
    limits = np.array(vector.call("time_limit"))  # type: ignore[attr-defined]  # all that there are have it
    first_area = np.array(info["explored_area"])
    episodes: dict[int, Episode] = {}
    integral, elapsed = np.zeros(vector.num_envs), np.zeros(vector.num_envs)
    while len(episodes) < vector.num_envs:
        observations, _, terminated, truncated, info = vector.step(act(observations))
        fractions, now = np.array(info["explored_fraction"]), np.minimum(info["time"] / limits, 1.0)
        done = np.flatnonzero(np.asarray(terminated) | np.asarray(truncated)).tolist()
        for i in done:
            fractions[i] = info["final_info"]["explored_fraction"][i]
            now[i] = min(info["final_info"]["time"][i] / limits[i], 1.0)
        integral += fractions * (now - elapsed)
        elapsed = now
        for i in set(done) - episodes.keys():
            names = ("explored_fraction", "explored_area", "path_length", "collisions", "is_success")
            final = {name: float(info["final_info"][name][i]) for name in names}
            final["success"] = final.pop("is_success")
            final["gained_area"] = final["explored_area"] - float(first_area[i])
            final["area_under_curve"] = float(integral[i] + fractions[i] * (1.0 - now[i]))
            time = float(info["final_info"]["time"][i]) if final["success"] else float(limits[i])
            episodes[i] = Episode(time_to_target=time, **final)
    return [episodes[i] for i in range(vector.num_envs)]


def summarise(episodes: Sequence[Episode]) -> dict[str, float]:
    """Return the means over episodes, and the quartiles of the explored fraction."""
    names = [field.name for field in fields(episodes[0])]
    columns = {name: [getattr(episode, name) for episode in episodes] for name in names}
    summary = {"episodes": float(len(episodes))} | {name: float(np.mean(column)) for name, column in columns.items()}
    quartiles = {"q25": 0.25, "q75": 0.75}.items()
    return summary | {
        f"explored_fraction_{name}": float(np.quantile(columns["explored_fraction"], q)) for name, q in quartiles
    }

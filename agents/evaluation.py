"""Evaluation of policies on test worlds during training."""

import math
from collections.abc import Callable, Sequence

import numpy as np
from gymnasium.vector import VectorEnv
from stable_baselines3.common.policies import BasePolicy

from lidarnaut.agents.algorithms import Actor
from lidarnaut.agents.config import EnvironmentConfig, TrainingConfig
from lidarnaut.agents.curves import LEARNED, SCORES, Row
from lidarnaut.agents.policies import make_policy
from lidarnaut.agents.vec_env import Observations, columns_of, make_env, make_vector
from lidarnaut.baselines.episode import decide_with, run_episode
from lidarnaut.baselines.policy import Policy, marked
from lidarnaut.envs.core import lidar_env_of
from lidarnaut.envs.files import resolve
from lidarnaut.envs.measures import EpisodeHistory, headline_of, measures_of


def evaluation_environment(config: TrainingConfig) -> EnvironmentConfig:
    """Return the environment configuration for evaluations."""
    changes = config.evaluation.arguments
    changes = ({"world_size": None} if "world" in changes else {}) | changes
    changes |= {"robots": ()} if "robot" in changes else {}
    # Each episode has an environment; that many processes are too expensive.
    changes |= {"vectorization": "sync"} if config.environment.vectorization == "async" else {}
    return config.environment.model_copy(update=changes)


class Evaluator:
    """Evaluates policies in the same test episodes, and summarises the results."""

    def __init__(self, config: TrainingConfig) -> None:
        self._episodes = config.evaluation.episodes
        environment = evaluation_environment(config)
        self._env = make_env(environment, "test")
        inner = lidar_env_of(self._env)
        self.headline = headline_of(inner.task.measures)
        others = (one for one in measures_of(inner.task.measures) if one is not self.headline)
        self.measures = (self.headline, *others)
        self.progress: str = inner.task.progress
        self.control_hz = 1.0 / inner.control_period
        self._max_speed: float = inner.robot.max_v
        self._vector = make_vector(environment, "test", self._episodes)

    def close(self) -> None:
        self._env.close()
        self._vector.close()

    def policy(self, policy: BasePolicy) -> Row:
        """Evaluate a policy with its most likely actions; return a row of the evaluation table."""
        histories = run_episodes(self._vector, Actor(policy), self._max_speed)
        return {"policy": marked(LEARNED, None, self._env)} | self.summarise(histories)

    def reference(self, name: str) -> Row:
        """Evaluate a non-learned policy, given by name; return a row of the evaluation table."""
        policies = [self.make_reference(name) for _ in range(self._episodes)]
        histories = [run_episode(self._env, policy, seed).history for seed, policy in enumerate(policies)]
        return {"policy": marked(name, policies[0], self._env)} | self.summarise(histories)

    def make_reference(self, name: str) -> Policy:
        """Return a non-learned policy by name or `module:attribute`; raise ValueError if unknown."""
        from lidarnaut.baselines import policies_for

        self._env.reset(seed=0)  # required by `policies_for`
        policy = make_policy(resolve(name, policies_for(self._env), "policy"), self._env.action_space)
        decide_with(policy, self._env)
        return policy

    def summarise(self, histories: Sequence[EpisodeHistory]) -> Row:
        """Return a row of the evaluation table: means of task progress and performance measures over several episodes.

        The row also contains quartiles and all values of the headline (main) measure. Infinite times, such as the time
        to a coverage that is never reached, are replaced by the time limit; infinite distances by the distance at
        maximum speed.
        """
        speeds = {"time_limit": 1.0, "distance_limit": self._max_speed}
        columns = {"progress": [float(np.mean(history.final[self.progress])) for history in histories]}
        for measure in self.measures:
            speed = speeds.get(measure.limit, math.inf)
            columns[measure.name] = [min(measure.compute(one), speed * one.time_limit) for one in histories]
        summary: Row = {"episodes": float(len(histories))}
        summary |= {name: mean for name, column in columns.items() if math.isfinite(mean := float(np.mean(column)))}
        name = self.headline.name
        summary |= {f"{name}_q{q}": float(np.quantile(columns[name], q / 100)) for q in (25, 75)}
        return summary | {SCORES: " ".join(f"{value:.5g}" for value in columns[name])}


def run_episodes(
    vector: VectorEnv[Observations, np.ndarray, np.ndarray],
    act: Callable[[Observations, np.ndarray], np.ndarray],
    max_speed: float = math.inf,
) -> list[EpisodeHistory]:
    """Run one episode in each sub-environment; return the recorded `info` entries of each episode.

    Sub-environment i has seed i. `act`: function that returns actions for observations and flags of episode starts,
    shape (num_envs,), bool. `max_speed`: maximum speed of the robot [m/s].
    """
    observations, info = vector.reset(seed=0)
    limits = vector.call("time_limit")  # type: ignore[attr-defined]
    names = [name for name, column in columns_of(info).items() if column.dtype.kind in "biuf"]
    rows, histories = [{name: np.array(info[name], dtype=np.float64) for name in names}], dict[int, EpisodeHistory]()
    starts = np.ones(vector.num_envs, dtype=np.bool_)
    while len(histories) < vector.num_envs:
        observations, _, terminated, truncated, info = vector.step(act(observations, starts))
        rows.append({name: np.array(info.get(name, math.nan * rows[0][name]), dtype=np.float64) for name in names})
        starts = np.asarray(terminated) | np.asarray(truncated)
        for i in np.flatnonzero(starts).tolist():
            final = {name: column[i] for name, column in columns_of(info["final_info"]).items()}
            for name in names:
                rows[-1][name][i] = final.get(name, math.nan)
            if i not in histories:
                samples = {name: np.array([row[name][i] for row in rows]) for name in names}
                histories[i] = EpisodeHistory(samples, final, float(limits[i]), max_speed)
    return [histories[i] for i in range(vector.num_envs)]

"""How well a policy does what the task asks for, in worlds that it was not trained in, measured while it trains."""

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
from lidarnaut.baselines.explorer import Policy, marked
from lidarnaut.envs.core import lidar_env_of
from lidarnaut.envs.files import resolve
from lidarnaut.envs.measures import Course, headline_of, measures_of


def evaluation_environment(config: TrainingConfig) -> EnvironmentConfig:
    """Return the environment in which the policy of a training is measured."""
    changes = config.evaluation.arguments
    changes |= {"world_size": None} if "world" in changes else {}
    changes |= {"robots": ()} if "robot" in changes else {}
    # An episode of evaluation has an environment of its own; for that many, processes would be too heavy.
    changes |= {"vectorization": "sync"} if config.environment.vectorization == "async" else {}
    return config.environment.model_copy(update=changes)


class Evaluator:
    """Runs the same episodes, on worlds of the test split, for learned and classic policies alike."""

    def __init__(self, config: TrainingConfig) -> None:
        """Make the environments; ValueError if there is no such environment, or it refuses an argument."""
        self._episodes = config.evaluation.episodes
        environment = evaluation_environment(config)
        self._env = make_env(environment, "test")
        inner = lidar_env_of(self._env)
        self.headline = headline_of(inner.task.measures)
        others = (one for one in measures_of(inner.task.measures) if one is not self.headline)
        self.measures = (self.headline, *others)
        """Measures of an episode, the headline first."""
        self.progress: str = inner.task.progress
        """Entry of `info` that says how much of the task is done."""
        self.control_hz = 1.0 / inner.control_period
        self._max_speed: float = inner.robot.max_v
        self._vector = make_vector(environment, "test", self._episodes)

    def close(self) -> None:
        """Close the environments."""
        self._env.close()
        self._vector.close()

    def policy(self, policy: BasePolicy) -> Row:
        """Measure a policy's most likely actions; draws nothing from the global generators."""
        courses = run_episodes(self._vector, Actor(policy), self._max_speed)
        return {"policy": marked(LEARNED, None, self._env)} | self.summarise(courses)

    def reference(self, name: str) -> Row:
        """Measure a classic policy, by name or `module:attribute`; ValueError if there is none for the task."""
        policies = [self.make_reference(name) for _ in range(self._episodes)]
        courses = [run_episode(self._env, policy, seed).course for seed, policy in enumerate(policies)]
        return {"policy": marked(name, policies[0], self._env)} | self.summarise(courses)

    def make_reference(self, name: str) -> Policy:
        """Return a classic policy for the task; raises as `reference`."""
        from lidarnaut.baselines import (
            policies_for,  # brings scikit-learn, which a training without references need not load
        )

        self._env.reset(seed=0)  # what the task offers is known from then on
        policy = make_policy(resolve(name, policies_for(self._env), "policy"), self._env.action_space)
        decide_with(policy, self._env)
        return policy

    def summarise(self, courses: Sequence[Course]) -> Row:
        """Return the means of the measures and of the progress at the end, quartiles of the headline, and all of it.

        What was never reached counts as the time limit, or as the distance that the robot can drive until then.
        """
        speeds = {"time_limit": 1.0, "distance_limit": self._max_speed}
        columns = {"progress": [float(np.mean(course.final[self.progress])) for course in courses]}
        for measure in self.measures:
            speed = speeds.get(measure.limit, math.inf)
            columns[measure.name] = [min(measure.compute(one), speed * one.time_limit) for one in courses]
        summary: Row = {"episodes": float(len(courses))}
        summary |= {name: mean for name, column in columns.items() if math.isfinite(mean := float(np.mean(column)))}
        name = self.headline.name
        summary |= {f"{name}_q{q}": float(np.quantile(columns[name], q / 100)) for q in (25, 75)}
        return summary | {SCORES: " ".join(f"{value:.5g}" for value in columns[name])}


def run_episodes(
    vector: VectorEnv[Observations, np.ndarray, np.ndarray],
    act: Callable[[Observations, np.ndarray], np.ndarray],
    max_speed: float = math.inf,
) -> list[Course]:
    """Run one episode in each environment, environment i seeded with i; return their courses.

    `act` is told in which environments episodes begin. Environments reset in the same step; those that end early are
    stepped on, and ignored. `max_speed` is the robot's [m/s].
    """
    observations, info = vector.reset(seed=0)  # environment i gets seed 0 + i
    limits = vector.call("time_limit")  # type: ignore[attr-defined]  # all that there are have it
    names = [name for name, column in columns_of(info).items() if column.dtype.kind in "biuf"]
    rows, courses = [{name: np.array(info[name], dtype=np.float64) for name in names}], dict[int, Course]()
    starts = np.ones(vector.num_envs, dtype=np.bool_)
    while len(courses) < vector.num_envs:
        observations, _, terminated, truncated, info = vector.step(act(observations, starts))
        rows.append({name: np.array(info.get(name, math.nan * rows[0][name]), dtype=np.float64) for name in names})
        starts = np.asarray(terminated) | np.asarray(truncated)
        for i in np.flatnonzero(starts).tolist():
            final = {name: column[i] for name, column in columns_of(info["final_info"]).items()}
            for name in names:
                rows[-1][name][i] = final.get(name, math.nan)
            if i not in courses:
                samples = {name: np.array([row[name][i] for row in rows]) for name in names}
                courses[i] = Course(samples, final, float(limits[i]), max_speed)
    return [courses[i] for i in range(vector.num_envs)]

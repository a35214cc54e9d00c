"""Evaluation of policies on test worlds during training."""

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from gymnasium.vector import VectorEnv
from stable_baselines3.common.policies import BasePolicy

from lidarnaut.agents.algorithms import Actor
from lidarnaut.agents.config import EnvironmentConfig, TrainingConfig
from lidarnaut.agents.curves import LEARNED, SCORES, TEST, VALIDATION, Row
from lidarnaut.agents.policies import make_policy
from lidarnaut.agents.vec_env import Observations, infos_of, make_env, make_vector
from lidarnaut.baselines.episode import decide_with, prepare, run_episode
from lidarnaut.baselines.policy import Policy, marked
from lidarnaut.envs.core import lidar_env_of
from lidarnaut.envs.files import parse_record, read_json, write_file
from lidarnaut.envs.measures import EpisodeHistory, HistoryRecorder, headline_of, measures_of
from lidarnaut.envs.progress import Progress
from lidarnaut.envs.worlds.library import Split


def evaluation_environment(config: TrainingConfig) -> EnvironmentConfig:
    """Return the environment configuration for evaluations."""
    changes = config.evaluation.arguments
    changes = ({"world_size": None} if "world" in changes else {}) | changes
    changes |= {"robots": () if "robot" in changes else config.environment.robots[:1]}
    # Each episode has an environment; that many processes are too expensive.
    changes |= {"vectorization": "sync"} if config.environment.vectorization == "async" else {}
    return config.environment.model_copy(update=changes)


REFERENCES = "references.json"
"""File of a run folder with the measures of the finished test episodes of the references, by policy."""
FIRST_SEED = {VALIDATION: 1_000_000, TEST: 0}
"""Seed of the first episode of each split. More than 100,000 episodes are not allowed."""


class Evaluator:
    """Evaluates policies in the same validation or test episodes, and summarises the results."""

    def __init__(self, config: TrainingConfig) -> None:
        number = config.evaluation.episodes
        self._episodes = {VALIDATION: number, TEST: config.evaluation.test_episodes or number}
        self._environment = evaluation_environment(config)
        self._env = make_env(self._environment, TEST)
        inner = lidar_env_of(self._env)
        self.headline = headline_of(inner.task.measures)
        others = (one for one in measures_of(inner.task.measures) if one is not self.headline)
        self.measures = (self.headline, *others)
        self.progress: str = inner.task.progress
        has_goal = any(one.name == "spl" for one in self.measures)
        self.shown = ("is_success", "success") if has_goal else (self.progress, self.progress.replace("_", " "))
        """Entry of `info` that the progress bar shows, and its label."""
        self.control_hz = 1.0 / inner.control_period
        self._max_speed: float = inner.robot_params.max_v
        self._vectors: dict[str, VectorEnv] = {}

    def close(self) -> None:
        self._env.close()
        for vector in self._vectors.values():
            vector.close()

    def policy(self, policy: BasePolicy, split: Split = VALIDATION, *, progress: bool = False) -> Row:
        """Evaluate a policy with its most likely actions; return a row of the evaluation table."""
        total = self._episodes[split]
        if split not in self._vectors:
            self._vectors[split] = make_vector(self._environment, split, total)
        with Progress(total=total, desc=split, unit="episode", leave=False, disable=not progress, miniters=0) as bar:
            vector, act, seed = self._vectors[split], Actor(policy), FIRST_SEED[split]
            histories = run_episodes(vector, act, self._max_speed, seed, bar)
            bar.set_postfix_str("", refresh=False)  # the simulated time of running episodes
        return self.summarise(marked(LEARNED, None, self._env), split, list(map(self.measure, histories)))

    def references(self, names: Mapping[str, str], run: Path, *, progress: bool = True) -> list[Row]:
        """Evaluate non-learned policies in the test episodes; return a row of the evaluation table for each.

        `names`: names in the table, by name of the policy. `run`: run folder, whose `REFERENCES` holds the finished
        episodes, which are not repeated.
        """
        path, number, rows = run / REFERENCES, self._episodes[TEST], list[Row]()
        done, total = self.finished_references(run), len(names) * number
        with Progress(total=total, desc="references", unit="episode", leave=False, disable=not progress) as bar:
            for name, label in names.items():
                values = done.setdefault(name, [])
                bar.update(len(values[:number]))
                for seed in range(len(values), number):
                    values.append(self.measure(run_episode(self._env, self.make_reference(name), seed).history))
                    write_file(path, json.dumps(done))
                    bar.update()
                rows.append({"steps": 0, **self.summarise(label, TEST, values[:number])})
        return rows

    def finished_references(self, run: Path) -> dict[str, list[dict[str, float]]]:
        """Read the measures of finished episodes by policy from `REFERENCES`; raise ValueError if damaged."""
        if not (path := run / REFERENCES).exists():
            return {}
        try:
            done = parse_record(read_json(path), str(path), dict[str, list[dict[str, float]]])
            for name, episodes in done.items():
                for episode in episodes:
                    self._check(episode, f"{path}: an episode of {name}")
        except ValueError as error:
            how = "allowed are lists of episodes by policy, with numbers by measure; without the file, references rerun"
            raise ValueError(f"{str(error).splitlines()[0]}; {how}") from error
        return done

    def _check(self, episode: Mapping[str, float], where: str) -> None:
        finite = "progress", "success", self.headline.name
        for name in ("progress", *(one.name for one in self.measures)):
            if name not in episode or (name in finite and not math.isfinite(episode[name])):
                raise ValueError(f"{where} has no {'finite ' * (name in finite)}{name}: {episode.get(name)}")

    def make_reference(self, name: str) -> Policy:
        """Return a policy by name; raise ValueError if unknown, see `lidarnaut.make_policy`."""
        policy = make_policy(name, self._env)
        decide_with(policy, self._env)
        return policy

    def mark(self, names: Iterable[str]) -> dict[str, str]:
        """Run one step of non-learned policies, which finds their mistakes; return their names in the table, by name.

        Names are marked if the policy uses ground truth. Raises ValueError if one is unknown, before the first step.
        """
        policies = {name: self.make_reference(name) for name in names}
        for policy in policies.values():
            prepare(self._env, policy, seed=0, steps=1)
        return {name: marked(name, policy, self._env) for name, policy in policies.items()}

    def measure(self, history: EpisodeHistory) -> dict[str, float]:
        """Return task progress and performance measures of an episode by name.

        Infinite times, such as the time to a coverage that is never reached, are replaced by the time limit; infinite
        distances by the distance at maximum speed. Raises ValueError if progress or headline measure are not finite.
        """
        speeds = {"time_limit": 1.0, "distance_limit": self._max_speed}
        values = {"progress": float(np.mean(history.final[self.progress]))}
        for measure in self.measures:
            limit = speeds.get(measure.limit, math.inf) * history.time_limit
            values[measure.name] = float(min(measure.compute(history), limit))
        self._check(values, "an episode")
        return values

    def summarise(self, policy: str, split: str, episodes: Sequence[Mapping[str, float]]) -> Row:
        """Return a row of the evaluation table: means of the measures of several episodes.

        The row also contains quartiles and all values of the headline (main) measure.
        """
        columns = {name: [one[name] for one in episodes] for name in episodes[0]}
        summary: Row = {"policy": policy, "split": split, "episodes": float(len(episodes))}
        summary |= {name: mean for name, column in columns.items() if math.isfinite(mean := float(np.mean(column)))}
        name = self.headline.name
        summary |= {f"{name}_q{q}": float(np.quantile(columns[name], q / 100)) for q in (25, 75)}
        return summary | {SCORES: " ".join(f"{value:.5g}" for value in columns[name])}


def run_episodes(
    vector: VectorEnv[Observations, np.ndarray, np.ndarray],
    act: Callable[[Observations, np.ndarray], np.ndarray],
    max_speed: float = math.inf,
    seed: int = 0,
    bar: Progress | None = None,
) -> list[EpisodeHistory]:
    """Run one episode in each sub-environment; return the recorded `info` entries of each episode.

    Sub-environment i has seed `seed` + i. `act`: function that returns actions for observations and flags of episode
    starts, shape (num_envs,), bool. `max_speed`: maximum speed of the robot [m/s]. `bar`: counts finished episodes and
    shows the simulated time of running ones.
    """
    observations, info = vector.reset(seed=seed)
    limits = vector.call("time_limit")  # type: ignore[attr-defined]
    recorders, histories = [HistoryRecorder() for _ in limits], dict[int, EpisodeHistory]()
    for recorder, one in zip(recorders, infos_of(info, vector.num_envs), strict=True):
        recorder.watch(one)
    starts = np.ones(vector.num_envs, dtype=np.bool_)
    while len(histories) < vector.num_envs:
        observations, _, terminated, truncated, info = vector.step(act(observations, starts))
        starts = np.asarray(terminated) | np.asarray(truncated)
        infos, finals = (infos_of(one, vector.num_envs) for one in (info, info.get("final_info", {})))
        for i in (i for i in range(vector.num_envs) if i not in histories):
            recorders[i].watch(finals[i] if starts[i] else infos[i])
            if starts[i]:
                histories[i] = recorders[i].history(finals[i], float(limits[i]), max_speed)
        if bar is not None:
            time = max((float(infos[i]["time"]) for i in range(vector.num_envs) if i not in histories), default=0.0)
            bar.set_postfix_str(f"{time:.0f} of at most {max(limits):.0f} s simulated", refresh=False)
            bar.update(len(histories) - bar.n)
    return [histories[i] for i in range(vector.num_envs)]

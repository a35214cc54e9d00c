"""Exploration episodes in the abstract simulator."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from .features import NUM_FEATURES
from .score import FrontierScore
from .tasks import TARGET, ExplorationTask, make_environment, make_world

MAX_RATIO = 3.0
"""Time limit of an episode, relative to the rule `gain_over_cost`."""
MISSING_COST = 2.0
"""Penalty on log time per explored fraction missing from the target."""
NUM_BEST = 5
"""Number of best candidates per decision, for feature variances."""


def explore(
    task: ExplorationTask, policy: Callable[[dict[str, np.ndarray]], np.int64], max_time: float = math.inf
) -> tuple[float, float]:
    """Explore a world by a policy that selects candidates, until the target or `max_time` [s].

    Returns log time [log s], with the penalty `MISSING_COST`, and explored fraction.
    """
    env = make_environment(task.robot, task.resolution, task.drift)
    observation, _ = env.reset(seed=task.seed, options={"world": make_world(task)})
    del observation["map"]
    explore = env.explore
    while not any(explore.is_over) and len(env.candidates) and explore.time < max_time:
        env.apply(policy(observation))
        observation = env.observe(observation)
    fraction = explore.task.coverage.explored_fraction
    # Incomplete episodes count as the time limit; giving up would otherwise seem fast.
    time = explore.time if fraction >= TARGET else max(explore.time, min(max_time, explore.time_limit))
    return math.log(max(time, explore.control_period)) + MISSING_COST * max(TARGET - fraction, 0.0), fraction


def compare(task: ExplorationTask, weights: Sequence[np.ndarray]) -> np.ndarray:
    """Evaluate score weights, shape (NUM_FEATURES,) each, in a task.

    Returns log time relative to the rule `gain_over_cost`, and explored fraction: shape (n, 2), float64.
    """
    base, _ = explore(task, FrontierScore())
    limit = MAX_RATIO * math.exp(base)
    return np.array([explore(task, FrontierScore(row), limit) for row in weights]) - (base, 0.0)


def feature_variances(task: ExplorationTask) -> np.ndarray:
    """Return the variance of features among the best candidates, shape (NUM_FEATURES,), float64.

    Variances of decisions are averaged over an episode of the rule `gain_over_cost`.
    """
    rule, variances = FrontierScore(), [np.zeros(NUM_FEATURES)]

    def choose(observation: dict[str, np.ndarray]) -> np.int64:
        features, scores = rule.rate(observation)
        variances.append(features[np.argsort(-scores, kind="stable")[:NUM_BEST]].var(axis=0))
        return np.int64(scores.argmax())

    explore(task, choose)
    return np.mean(variances, axis=0)

"""Exploration episodes without simulated driving, in the environment `ExploreFrontiersAbstract-v0`."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from .features import NUM_FEATURES
from .score import FrontierScore
from .tasks import TARGET, ExplorationTask, make_environment, make_world

MAX_RATIO = 3.0
"""Time limit of an episode, divided by the time that the rule `gain_over_cost` takes."""
MISSING_COST = 2.0
"""Weight of incomplete exploration in the cost of an episode: log(time) + weight x (target - explored fraction)."""
NUM_BEST = 5
"""Number of highest-rated frontiers per decision used to compute feature variances."""


def explore(
    task: ExplorationTask, policy: Callable[[dict[str, np.ndarray]], np.int64], max_time: float = math.inf
) -> tuple[float, float]:
    """Run an exploration episode with a policy that selects frontiers; return cost and explored fraction.

    The episode ends at target coverage, without frontiers, or after `max_time` [s]. The cost is log(time [s]) +
    `MISSING_COST` x missing coverage. If the target is missed, the time is at least the time limit.
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
    """Explore a world with each of n linear frontier scores, and compare the times with a classic rule.

    `weights`: n vectors, shape (NUM_FEATURES,). Returns log(exploration time / time of the rule) and explored fraction,
    shape (n, 2), float64.
    """
    base, _ = explore(task, FrontierScore())
    limit = MAX_RATIO * math.exp(base)
    return np.array([explore(task, FrontierScore(row), limit) for row in weights]) - (base, 0.0)


def feature_variances(task: ExplorationTask) -> np.ndarray:
    """Return the variance of each feature over the `NUM_BEST` best frontiers of a decision, averaged over an episode.

    The rule `gain_over_cost` rates frontiers. Result: shape (NUM_FEATURES,), float64.
    """
    rule, variances = FrontierScore(), [np.zeros(NUM_FEATURES)]

    def choose(observation: dict[str, np.ndarray]) -> np.int64:
        features, scores = rule.rate(observation)
        variances.append(features[np.argsort(-scores, kind="stable")[:NUM_BEST]].var(axis=0))
        return np.int64(scores.argmax())

    explore(task, choose)
    return np.mean(variances, axis=0)

"""Episodes of the abstract simulator, and how long policies take in them."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from envs.abstract import ExploreFrontiersAbstractEnv

from .features import NUM_FEATURES
from .score import FrontierScore
from .tasks import TARGET, Task, make_environment, make_world

MAX_RATIO = 3.0
"""Episodes end after so many times the time that the reference takes."""
MISSING_COST = 2.0
"""What an episode that ends before the target adds to the logarithm of its time, per explored fraction that is missing.
"""
NUM_BEST = 5
"""Best candidates of a decision between which features are told to differ or not."""
Chooser = Callable[[dict[str, np.ndarray]], np.int64]


def explore(env: ExploreFrontiersAbstractEnv, policy: Chooser, task: Task, max_time: float = math.inf) -> float:
    """Explore a task's world, and return the logarithm of the time to the target [log s]; see `MISSING_COST`.

    Args:
        env: the task's environment.
        policy: chooses candidates by observations.
        task: gives world and seed.
        max_time: time after which the episode ends [s].
    """
    observation, _ = env.reset(seed=task.seed, options={"world": make_world(task)})
    del observation["map"]  # scores do not look at it
    explore = env.explore
    while not any(explore.is_over) and len(env.candidates) and explore.time < max_time:
        env.apply(policy(observation))
        observation = env.observe(observation)
    fraction = explore.task.coverage.explored_fraction
    # An episode that was cut short has taken at least that long; one that gave up would otherwise look fast.
    time = explore.time if fraction >= TARGET else max(explore.time, min(max_time, explore.time_limit))
    return math.log(max(time, explore.control_period)) + MISSING_COST * max(TARGET - fraction, 0.0)


def compare(task: Task, weights: Sequence[np.ndarray], reference: np.ndarray) -> np.ndarray:
    """Return the logarithms of the times of scores over that of a reference, in one task: shape (n,), float64.

    Args:
        task: the task.
        weights: of the scores, n times shape (NUM_FEATURES,).
        reference: weights of the reference.
    """
    env = make_environment(task)
    base = explore(env, FrontierScore(reference), task)
    limit = MAX_RATIO * math.exp(base)
    return np.array([explore(env, FrontierScore(row), task, limit) - base for row in weights])


def validate(task: Task, weights: np.ndarray, reference: np.ndarray) -> tuple[float, float]:
    """Return the logarithm of the time of a score over that of a reference, and the explored fraction at its end.

    `weights` and `reference` have the shape (NUM_FEATURES,).
    """
    (ratio,) = compare(task, [weights], reference)
    return float(ratio), make_environment(
        task
    ).explore.task.coverage.explored_fraction  # as the score's episode left it


def feature_variances(task: Task) -> np.ndarray:
    """Return how much features differ between the candidates that matter, in one task: shape (NUM_FEATURES,), float64.

    Their variances among the best candidates of each decision, by the rule that scores start from, averaged over an
    episode of that rule.
    """
    rule, variances = FrontierScore(), [np.zeros(NUM_FEATURES)]

    def choose(observation: dict[str, np.ndarray]) -> np.int64:
        features, scores = rule.rate(observation)
        variances.append(features[np.argsort(-scores, kind="stable")[:NUM_BEST]].var(axis=0))
        return np.int64(scores.argmax())

    explore(make_environment(task), choose, task)
    return np.mean(variances, axis=0)

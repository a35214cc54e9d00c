"""Episodes of the abstract simulator, and how long policies take in them."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from .features import NUM_FEATURES
from .score import FrontierScore
from .tasks import TARGET, Task, make_environment, make_world

MAX_RATIO = 3.0
"""Episodes end after so many times the time that the rule takes."""
MISSING_COST = 2.0
"""What an episode that ends before the target adds to the logarithm of its time, per explored fraction that is missing.
"""
NUM_BEST = 5
"""Best candidates of a decision between which features are told to differ or not."""


def explore(
    task: Task, policy: Callable[[dict[str, np.ndarray]], np.int64], max_time: float = math.inf
) -> tuple[float, float]:
    """Explore a task's world until the target, or for a time [s], by a policy that chooses candidates by observations.

    Returns the logarithm of the time [log s], see `MISSING_COST`, and the explored fraction.
    """
    env = make_environment(task.robot, task.resolution, task.drift)
    observation, _ = env.reset(seed=task.seed, options={"world": make_world(task)})
    del observation["map"]  # scores do not look at it
    explore = env.explore
    while not any(explore.is_over) and len(env.candidates) and explore.time < max_time:
        env.apply(policy(observation))
        observation = env.observe(observation)
    fraction = explore.task.coverage.explored_fraction
    # An episode that was cut short has taken at least that long; one that gave up would otherwise look fast.
    time = explore.time if fraction >= TARGET else max(explore.time, min(max_time, explore.time_limit))
    return math.log(max(time, explore.control_period)) + MISSING_COST * max(TARGET - fraction, 0.0), fraction


def compare(task: Task, weights: Sequence[np.ndarray]) -> np.ndarray:
    """Return how scores of some weights, shape (NUM_FEATURES,) each, do in a task: shape (n, 2), float64.

    Columns are the logarithm of the time over that of the rule `gain_over_cost`, and the explored fraction.
    """
    base, _ = explore(task, FrontierScore())
    limit = MAX_RATIO * math.exp(base)
    return np.array([explore(task, FrontierScore(row), limit) for row in weights]) - (base, 0.0)


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

    explore(task, choose)
    return np.mean(variances, axis=0)

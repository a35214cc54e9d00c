"""What ground truth about gains would buy."""

import numpy as np
import pytest

from agents.frontiers.features import LEAST_GAIN, PRIOR
from agents.frontiers.score import FrontierScore
from benchmarks.privileged_gain import KNOWN, PrivilegedScore, main, true_gains
from envs.abstract import ExploreFrontiersAbstractEnv


@pytest.fixture(scope="module")
def env():
    return ExploreFrontiersAbstractEnv(world="rooms", world_size=(10.0, 10.0), target_coverage=0.95)


def decisions(env, choose):
    """Yield the observation, and what `choose` makes of it, until the episode ends."""
    observation, _ = env.reset(seed=3)
    done = False
    while not done:
        choice = choose(observation)
        if len(env.candidates):
            yield observation, choice
        observation, _, terminated, truncated, _ = env.step(choice)
        done = terminated or truncated


def test_true_gains_are_what_is_left_in_view(env):
    seen, left = [], []
    for _ in decisions(env, FrontierScore()):
        gains = true_gains(env)
        assert (gains >= 0.0).all()
        # Neighbouring rays sweep cells of each other's at short range.
        seen.append((gains.max(), gains.sum(), env.candidates.visible.sum()))
        left.append(env.explore.task.coverage.area.area - env.explore.task.coverage.explored_area)
    largest, total, optimistic = np.array(seen).T
    assert (largest <= 1.1 * np.array(left)).all()
    assert 0.0 < total.sum() < 0.7 * optimistic.sum()


def test_frontiers_that_gain_nothing_come_last(env):
    avoided = 0
    for observation, choice in decisions(env, PrivilegedScore(PRIOR, env, "which gain nothing")):
        gains = true_gains(env)
        if gains.max() >= LEAST_GAIN and not env.candidates.failures.any():
            assert gains[choice] >= LEAST_GAIN
            avoided += gains[FrontierScore()(observation)] < LEAST_GAIN
    assert avoided > 0


def test_true_gains_take_the_place_of_the_optimistic_ones(env):
    for _, choice in decisions(env, PrivilegedScore(PRIOR, env, "true gains")):
        if not env.candidates.failures.any():
            utility = (true_gains(env) + 0.3) / (env.candidates.costs + 3.0)
            assert utility[choice] == pytest.approx(utility.max(), rel=1e-5)


def test_times_are_compared_with_those_of_the_scores_as_they_are(capsys):
    main(tasks=2, jobs=1)
    rows = [line for line in capsys.readouterr().out.splitlines() if KNOWN[0] in line]
    assert len(rows) == 2
    assert all("1.000 [1.000, 1.000]" in row for row in rows)

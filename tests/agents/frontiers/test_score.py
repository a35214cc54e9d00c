import json
from types import SimpleNamespace

import numpy as np
import pytest
import safetensors.numpy

from lidarnaut import make_policy
from lidarnaut.agents.frontiers.features import NAMES, NEAREST, NUM_FEATURES, PRIOR, score_features
from lidarnaut.agents.frontiers.score import (
    MAX_CANDIDATES,
    RECORD_FILE,
    WEIGHTS_FILE,
    FrontierScore,
    ScoreExplorer,
    pretrained_rating,
)
from lidarnaut.agents.learned import find_policy, load_policy
from lidarnaut.agents.run_folder import CheckpointError
from lidarnaut.baselines.episode import run_episode
from lidarnaut.baselines.frontier.rules import nearest
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.decisions.abstract import ExploreFrontiersAbstractEnv
from lidarnaut.envs.decisions.explore_frontiers import ExploreFrontiersEnv
from lidarnaut.envs.navigation import GainOverCost
from lidarnaut.envs.navigation.frontiers.candidates import FAILURES
from lidarnaut.envs.tasks.explore import Explore

QUICK = {"world": "rooms", "world_size": (10.0, 10.0), "target_coverage": 0.95}


PARTS = "candidates", "sectors", "gaps", "robot"


def drive(env, policy, seed, num_steps):
    observation, _ = env.reset(seed=seed)
    for _ in range(num_steps):
        choice = policy(observation)
        if len(env.candidates):
            yield observation, choice
        observation, _, terminated, truncated, _ = env.step(choice)
        if terminated or truncated:
            break


@pytest.mark.parametrize("make", [ExploreFrontiersAbstractEnv, ExploreFrontiersEnv])
@pytest.mark.parametrize(("weights", "rule"), [(PRIOR, GainOverCost()), (NEAREST, nearest)])
def test_weights_of_rules_choose_as_the_rules_do(make, weights, rule):
    env, policy = make(physics="kinematic", **QUICK), FrontierScore(weights)
    agree = [choice == rule(env.candidates, env.belief).argmax() for _, choice in drive(env, policy, 4, 30)]
    assert len(agree) > 10
    assert all(agree)


def test_features_are_finite_and_vary():
    env = ExploreFrontiersAbstractEnv(**QUICK)
    rows = []
    for seed in range(4):
        for observation, _ in drive(env, FrontierScore(), seed, 25):
            rows.append(score_features(*(observation[name] for name in PARTS), len(env.candidates)))
    features = np.vstack(rows)
    assert features.shape[1] == NUM_FEATURES == len(NAMES)
    assert np.isfinite(features).all()
    assert np.abs(features).max() < 20.0
    still = {name for name, spread in zip(NAMES, np.ptp(features, axis=0)) if spread < 1e-6}
    assert still <= {"failures"}


def test_what_failed_comes_last():
    env, policy = ExploreFrontiersAbstractEnv(**QUICK), FrontierScore()
    observation, first = next(seen for seen in drive(env, policy, 1, 30) if len(env.candidates) >= 3)
    observation["candidates"][first, FAILURES] = 1.0 / 3.0
    assert policy(observation) != first


def test_weights_that_fit_are_saved_and_loaded(tmp_path):
    weights = np.random.default_rng(0).standard_normal(NUM_FEATURES)
    FrontierScore(weights).save(tmp_path / "policy", {"seed": 3})
    np.testing.assert_array_equal(FrontierScore.load(tmp_path / "policy").weights, weights)
    assert json.loads((tmp_path / "policy" / RECORD_FILE).read_text())["seed"] == 3
    for weights in (np.zeros(3), np.full(len(PRIOR), np.inf)):
        with pytest.raises(ValueError, match="finite"):
            FrontierScore(weights)


@pytest.mark.parametrize(
    ("file", "content"),
    [
        (RECORD_FILE, None),
        (RECORD_FILE, b"{"),
        (RECORD_FILE, b'{"features": ["other"]}'),
        (WEIGHTS_FILE, b"cut"),
        (WEIGHTS_FILE, safetensors.numpy.save({"weights": np.full(NUM_FEATURES, np.nan)})),
    ],
)
def test_damage_is_named(tmp_path, file, content):
    FrontierScore().save(tmp_path / "policy", {})
    (tmp_path / "policy" / file).unlink()
    if content is not None:
        (tmp_path / "policy" / file).write_bytes(content)
    with pytest.raises(CheckpointError, match="policy"):
        FrontierScore.load(tmp_path / "policy")


@pytest.mark.parametrize("name", ["prior", "pretrained/frontiers"])
def test_explorers_of_scores_explore_and_that_of_the_prior_as_the_rule_does(name):
    explorer = ScoreExplorer(FrontierScore()) if name == "prior" else load_policy(find_policy(name))
    env = LidarEnv(Explore, physics="kinematic", **QUICK)
    episode = run_episode(env, explorer, 3)
    assert episode.explored_fraction >= 0.95
    if name == "prior":
        classic = run_episode(env, make_policy("gain_over_cost"), 3)
        assert (episode.time_to_95, episode.path_length) == (classic.time_to_95, classic.path_length)


def test_more_candidates_than_a_score_rates_are_refused():
    navigator = SimpleNamespace(candidates=range(MAX_CANDIDATES + 1))
    with pytest.raises(ValueError, match="max_candidates must be at most 48 with a score, got 49 candidates"):
        pretrained_rating()(navigator, None)

"""Features of candidates, and the policy that scores them."""

import json

import numpy as np
import pytest

from agents.frontiers.features import NAMES, NEAREST, NUM_FEATURES, PRIOR, score_features
from agents.frontiers.score import RECORD_FILE, WEIGHTS_FILE, FrontierScore, ScoreExplorer
from agents.learned import find_policy, load_policy
from agents.run_folder import CheckpointError
from baselines import make_explorer
from baselines.episode import run_episode
from baselines.frontier.rules import nearest
from envs.abstract import ExploreFrontiersAbstractEnv
from envs.core import LidarEnv
from envs.explore_frontiers import ExploreFrontiersEnv
from envs.navigation import GainOverCost
from envs.tasks.explore import Explore

QUICK = {"world": "rooms", "world_size": (10.0, 10.0), "target_coverage": 0.95}


def features_of(env, observation):
    parts = (observation[name] for name in ("candidates", "sectors", "gaps", "robot"))
    return score_features(*parts, len(env.candidates))


@pytest.mark.parametrize("make", [ExploreFrontiersAbstractEnv, ExploreFrontiersEnv])
@pytest.mark.parametrize(("weights", "rule"), [(PRIOR, GainOverCost()), (NEAREST, nearest)])
def test_weights_of_rules_choose_as_the_rules_do(make, weights, rule):
    env, policy = make(physics="kinematic", **QUICK), FrontierScore(weights)
    observation, _ = env.reset(seed=4)
    count = 0
    for _ in range(30):
        choice = policy(observation)
        if len(env.candidates):
            count += 1
            assert choice == rule(env.candidates, env.belief).argmax()
        observation, _, terminated, truncated, _ = env.step(choice)
        if terminated or truncated:
            break
    assert count > 10


def test_features_are_finite_and_vary():
    env = ExploreFrontiersAbstractEnv(**QUICK)
    rows = []
    for seed in range(4):
        observation, _ = env.reset(seed=seed)
        for _ in range(25):
            if len(env.candidates):
                rows.append(features_of(env, observation))
            observation, _, terminated, truncated, _ = env.step(FrontierScore()(observation))
            if terminated or truncated:
                break
    features = np.vstack(rows)
    assert features.shape[1] == NUM_FEATURES == len(NAMES)
    assert np.isfinite(features).all()
    assert np.abs(features).max() < 20.0
    still = {name for name, spread in zip(NAMES, np.ptp(features, axis=0)) if spread < 1e-6}
    assert still <= {"failures"}


def test_what_failed_comes_last():
    env = ExploreFrontiersAbstractEnv(**QUICK)
    observation, _ = env.reset(seed=1)
    policy = FrontierScore()
    while len(env.candidates) < 3:
        observation, *_ = env.step(policy(observation))
    first = policy(observation)
    observation["candidates"][first, 13] = 1.0 / 3.0
    assert policy(observation) != first


def test_weights_are_saved_and_loaded(tmp_path):
    weights = np.random.default_rng(0).standard_normal(NUM_FEATURES)
    FrontierScore(weights).save(tmp_path / "policy", {"seed": 3})
    np.testing.assert_array_equal(FrontierScore.load(tmp_path / "policy").weights, weights)
    assert json.loads((tmp_path / "policy" / RECORD_FILE).read_text())["seed"] == 3


@pytest.mark.parametrize("damage", ["no record", "json", "features", "truncated", "nan"])
def test_damage_is_named(tmp_path, damage):
    folder = tmp_path / "policy"
    policy = FrontierScore()
    if damage == "nan":
        policy.weights = np.full(NUM_FEATURES, np.nan)
    policy.save(folder, {})
    record = folder / RECORD_FILE
    if damage == "no record":
        record.unlink()
    elif damage == "json":
        record.write_text("{")
    elif damage == "features":
        record.write_text(json.dumps({"features": ["other"]}))
    elif damage == "truncated":
        (folder / WEIGHTS_FILE).write_bytes((folder / WEIGHTS_FILE).read_bytes()[:-40])
    with pytest.raises(CheckpointError, match="policy"):
        FrontierScore.load(folder)


@pytest.mark.parametrize("weights", [np.zeros(3), np.full(len(PRIOR), np.inf)])
def test_weights_must_fit(weights):
    with pytest.raises(ValueError, match="finite"):
        FrontierScore(weights)


def test_the_explorer_of_the_prior_is_that_of_the_rule():
    env = LidarEnv(Explore, physics="kinematic", **QUICK)
    learned, classic = (
        run_episode(env, explorer, 3) for explorer in (ScoreExplorer(FrontierScore()), make_explorer("gain_over_cost"))
    )
    assert learned.time_to_95 == classic.time_to_95
    assert learned.path_length == classic.path_length


def test_what_comes_with_the_package_explores():
    explorer = load_policy(find_policy("pretrained/frontiers"))
    env = LidarEnv(Explore, physics="kinematic", **QUICK)
    assert run_episode(env, explorer, 3).explored_fraction >= 0.95
    with pytest.raises(CheckpointError, match="pretrained/frontiers"):
        find_policy("pretrained/fronteers")

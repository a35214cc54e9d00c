import contextlib
import shutil

import numpy as np
import pytest

from lidarnaut.agents.algorithms import build_policy
from lidarnaut.agents.checkpoint import load_checkpoint
from lidarnaut.agents.curves import read_evaluations
from lidarnaut.agents.evaluation import Evaluator, run_episodes
from lidarnaut.agents.explorer import LearnedPolicy
from lidarnaut.agents.frontiers.features import NEAREST
from lidarnaut.agents.frontiers.score import FrontierScore
from lidarnaut.agents.frontiers.tasks import HELD_OUT, training_world, validation_world
from lidarnaut.agents.policies import make_policy
from lidarnaut.agents.run_folder import CheckpointError, find_checkpoint
from lidarnaut.agents.training import train
from lidarnaut.agents.vec_env import make_env, make_vector
from lidarnaut.baselines.episode import run_episode
from lidarnaut.envs.worlds import WORLD_NAMES
from tests.agents.tiny import tiny

ENVIRONMENT = {"id": "lidarnaut/ExploreFrontiersAbstract-v0", "world": "rooms", "world_size": [8, 8], "num_workers": 0}
ENVIRONMENT |= {"slam": "truth", "target_coverage": 0.9, "reward": {"explored": 0.03, "time": -0.01, "completed": 0.0}}
DATA = {
    "environment": ENVIRONMENT,
    "hyperparameters": {"n_steps": 8, "batch_size": 16, "n_epochs": 2, "gamma": 1.0, "learning_rate": "lin_0.003"},
    "network": {"width": 16, "heads": 2, "prior": 1.0},
    "evaluation": {"every": 1000, "episodes": 3, "references": ["random", "gain_over_cost"]},
    "checkpoints": {"every": 32},
}


def changed(total_steps=64, **sections):
    data = {name: values | sections.get(name, {}) for name, values in DATA.items()}
    return tiny("PPO", "ExploreFrontiersAbstract", total_steps=total_steps, num_envs=4, **data)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return train(changed(), run=tmp_path_factory.mktemp("runs") / "choices", progress=False)


def untrained_row(run, config):
    """Return the row of the untrained policy in the test episodes."""
    folder = find_checkpoint(f"{run}@0")
    with contextlib.closing(Evaluator(config)) as evaluator:
        return evaluator.policy(build_policy(load_checkpoint(folder), folder), "test")


def test_a_run_measures_references_and_itself(run):
    chance, rule, untrained, trained, result = rows = read_evaluations(run)
    assert [row["policy"] for row in rows] == ["random", "gain_over_cost", *3 * ["learned"]]
    assert [row["split"] for row in rows] == ["test", "test", "validation", "validation", "test"]
    assert (untrained["steps"], trained["steps"]) == (0, 64)
    assert result["steps"] == int(find_checkpoint(run, "best").name[5:])
    # The episodes are equal, and an untrained network is equal to the rule.
    untrained = untrained_row(run, changed())
    for name in ("explored_fraction", "time_to_90", "path_length", "success"):
        assert untrained[name] == pytest.approx(rule[name])
    assert rule["success"] == 1.0
    assert 10.0 < rule["time_to_90"] < chance["time_to_90"]
    record = load_checkpoint(find_checkpoint(run)).record
    assert (str(record.action), str(record.observation["action_mask"])) == ("Discrete(48)", "MultiBinary(48)")


def test_a_training_starts_from_a_score_which_its_checkpoints_hold(tmp_path):
    folder = tmp_path / "nearest"
    FrontierScore(NEAREST).save(folder, {})
    config = changed(network={"prior_policy": str(folder)}, evaluation={"references": ["nearest"]}, total_steps=32)
    run = train(config, run=tmp_path / "run", progress=False)
    shutil.rmtree(folder)
    reference, *_ = read_evaluations(run)
    assert untrained_row(run, config)["time_to_90"] == reference["time_to_90"]
    checkpoint = find_checkpoint(run)
    np.testing.assert_array_equal(load_checkpoint(checkpoint).policy["network.score"].numpy(), NEAREST)
    env = make_env(config.environment, "test")
    assert env.action_space.contains(LearnedPolicy.load(checkpoint)(env.reset(seed=0)[0]))


def test_priors_and_checkpoints_that_do_not_fit_are_refused(run, tmp_path):
    for folder, message in ((run, "holds no readable frontier score"), (tmp_path, "is neither a run folder")):
        with pytest.raises(CheckpointError, match=message):
            train(changed(network={"prior_policy": str(folder)}), run=tmp_path / "run", progress=False)
    assert not (tmp_path / "run").exists()
    twists = {"id": "lidarnaut/Explore-v0", "world_size": [8, 8]}
    config = changed(environment=twists).model_copy(update={"network": {}})
    with pytest.raises(CheckpointError, match=r"environment\.id: .*ExploreFrontiersAbstract-v0"):
        train(config, resume=run, progress=False)
    with pytest.raises(CheckpointError, match=r"network\.width: 16, not 32"):
        train(changed(network={"width": 32}), resume=run, progress=False)


def test_an_evaluation_gives_what_single_episodes_give():
    config = changed()
    vector = make_vector(config.environment, "test", 3)
    together = run_episodes(vector, lambda seen, starts: np.zeros(3, dtype=np.int64))
    env = make_env(config.environment, "test")
    first = make_policy(lambda observation: 0, env.action_space)
    measures = {measure.name: measure for measure in env.unwrapped.explore.task.measures}
    for seed, history in enumerate(together):
        alone = run_episode(env, first, seed)
        for name in ("time_to_90", "explored_fraction", "area_under_curve"):
            assert measures[name].compute(history) == getattr(alone, name)


def test_worlds_to_train_in_and_to_validate_in_are_apart():
    rng = np.random.default_rng(0)
    trained = {training_world(rng).name for _ in range(60)}
    validated = {validation_world(rng).name for _ in range(30)}
    assert trained & set(WORLD_NAMES)
    assert not trained & set(HELD_OUT.worlds)
    assert {int(name.split("-")[1]) % 2 for name in trained - set(WORLD_NAMES)} == {0}
    assert {int(name.split("-")[1]) % 2 for name in validated} == {1}

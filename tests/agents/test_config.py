import contextlib
import copy
from pathlib import Path

import pytest

from lidarnaut import train_command as train
from lidarnaut.agents import training
from lidarnaut.agents.algorithms import find_algorithm, prepare
from lidarnaut.agents.config import TrainingConfig, parse_config
from lidarnaut.agents.recipes import with_recipe
from lidarnaut.agents.vec_env import make_vec_env
from lidarnaut.envs.files import dump_record, read_mapping, read_record

CONFIGS = sorted((Path(__file__).parents[2] / "configs").glob("*.yaml"))


@pytest.mark.parametrize("path", [path for path in CONFIGS if "experiment" in read_mapping(path)], ids=str)
def test_configurations_of_the_project_are_valid_and_survive_being_written(path, tmp_path):
    config = parse_config(with_recipe(read_mapping(path))[0], str(path))
    assert config.experiment == path.stem
    (tmp_path / "again.yaml").write_text(dump_record(config))
    assert read_record(tmp_path / "again.yaml", type(config)) == config


def test_numbers_in_scientific_notation_are_numbers(tmp_path):
    path = tmp_path / "a.yaml"
    rates = "hyperparameters: {learning_rate: 3e-4, ent_coef: 1E-3, gamma: .9e0}"
    path.write_text(f"experiment: a\ntotal_steps: 3e5\nalgorithm: SAC\n{rates}\n")
    config = read_record(path, TrainingConfig)
    assert config.total_steps == 300_000
    assert isinstance(config.total_steps, int)
    assert list(config.hyperparameters.values()) == [3e-4, 1e-3, 0.9]


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("total_stesp", 5, r"unknown key 'total_stesp' \(did you mean 'total_steps'\?"),
        ("algorithm", "SCA", r"algorithm: unknown algorithm 'SCA' \(did you mean 'SAC'\?\)"),
        ("algorithm", "evolutionn", r"unknown algorithm 'evolutionn' \(did you mean 'evolution'\?\)"),
        ("algorithm", "evolution", r"unknown key 'total_steps'"),
        ("evaluation.evry", 5, r"unknown key 'evaluation.evry' \(did you mean 'every'\?"),
        ("experiment", "../up", r"experiment: .*pattern"),
        ("environment.vectorization", "fork", r"vectorization: .*'native', 'sync' or 'async', got 'fork'"),
        ("environment.world", "nowhere", "world 'nowhere' is unknown"),
        ("hyperparameters.learnig_rate", 1e-3, r"PPO has no 'learnig_rate' \(did you mean 'learning_rate'\?\)"),
        ("hyperparameters.learning_rate", "lin_fast", r"learning_rate: not of the form lin_3e-4, got 'lin_fast'"),
        ("hyperparameters.n_steps", "many", r"n_steps must be a whole number from 1, got 'many'"),
        ("hyperparameters.gamma", "no:such", r"hyperparameters\.gamma: 'no:such': there is no module 'no'"),
        ("hyperparameters.n_steps", 10**9, r"num_envs times hyperparameters\.n_steps .* = 4000000000 steps"),
        ("hyperparameters.batch_size", -1, r"hyperparameters\.batch_size: must be a number from 1, got -1"),
        ("hyperparameters.batch_size", 64.0, r"hyperparameters\.batch_size: Input should be a valid integer, got 64.0"),
        ("hyperparameters.gamma", 2, r"hyperparameters\.gamma: must be a number from 0 to 1, got 2"),
        ("hyperparameters.gamma", float("nan"), r"hyperparameters\.gamma: Out of range float .*, got nan"),
        ("hyperparameters.clip_range", "x", r"hyperparameters\.clip_range: .* valid number; .* callable, got 'x'"),
        ("hyperparameters.learning_rate", 1e300, r"hyperparameters\.learning_rate: .*overflow"),
        ("hyperparameters.policy_kwargs", {"foo": 1}, r"hyperparameters\.policy_kwargs: .*argument 'foo'"),
        ("hyperparameters.policy_kwargs", {"optimizer_class": "torch.optim:LBFGS"}, r"policy_kwargs: .*LBFGS"),
        ("network.speedd", 1.0, r"network: unknown key 'speedd' \(did you mean 'speed'\?\); allowed are .*speed"),
        ("checkpoints.every", 100, r"checkpoints.every is 100, but an update takes .* 128 steps"),
        ("SAC.train_freq", [4], r"train_freq must be a whole number from 1, or .*, got \[4\]"),
        ("SAC.train_freq", [1, "episode"], r"train_freq must be .*, or with num_envs 1 \[number, episode\], got \[1, "),
        ("SAC.buffer_size", 10**13, r"hyperparameters\.buffer_size: .*Unable to allocate"),
        ("SAC.gradient_steps", -2, r"hyperparameters\.gradient_steps: must be a number from -1, got -2"),
    ],
)
def test_mistakes_are_named_with_what_is_allowed_and_leave_no_run_behind(tiny_data, tmp_path, key, value, message):
    data = copy.deepcopy(tiny_data)
    *section, key = key.split(".")
    if section == ["SAC"]:
        data |= {"algorithm": "SAC", "hyperparameters": {}}
        section = ["hyperparameters"]
    (data.setdefault(section[0], {}) if section else data)[key] = value
    with pytest.raises(ValueError, match=message):
        training.train(parse_config(data, "mem"), run=tmp_path / "run", progress=False)
    assert not (tmp_path / "run").exists()


@pytest.fixture
def configs(monkeypatch, tmp_path):
    """Collect configurations in place of trainings."""
    configs = []
    monkeypatch.setattr(
        "lidarnaut.agents.learning.run_training", lambda config, **_: configs.append(config) or tmp_path
    )
    return configs


def test_the_command_line_overrides_the_file(tmp_path, configs, tiny_config):
    path = tmp_path / "tiny.yaml"
    path.write_text(dump_record(tiny_config))
    arguments = ["--config", str(path), "--seed", "7", "--hyperparameters.learning-rate", "1e-3"]
    arguments += ["--environment.reward.time", "-2", "--environment.observations", "scan", "motion"]
    arguments += ["--evaluation.environment.world", "rooms", "--environment.randomize={lidar.dropout: [0, 0.1]}"]
    assert train.main(arguments) == 0
    (config,) = configs
    assert (config.seed, config.evaluation.environment) == (7, {"world": "rooms"})
    assert config.hyperparameters == tiny_config.hyperparameters | {"learning_rate": 1e-3}
    own = {"reward": {"time": -2}, "observations": ("scan", "motion"), "randomize": {"lidar.dropout": (0, 0.1)}}
    assert config.environment.arguments == tiny_config.environment.arguments | own


ID = ["--config", "tiny.yaml", "--environment.id"]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--seed", "1"], "--config FILE, or a run to resume"),
        (["--config", ""], "unknown configuration ''"),
        (["--config", "no.yaml"], "no.yaml: no such file"),
        ([*ID, "CartPole-v1", "--environment.time-limit", "1"], "has no argument 'time_limit'; allowed are sutton"),
        ([*ID, "lidarnaut/Navigat-v0"], "unknown id 'lidarnaut/Navigat-v0' (did you mean 'li"),
        ([*ID, "no_such_module:Mine-v0"], "there is no module 'no_such_module'"),
        ([*ID, "lidarnaut/Explore-v0", "--environment.wrold", "rooms"], "'wrold' (did you mean 'world'?); allowed are"),
        (["--config", "tiny.yaml", "--evaluation.references", "random", "nerest"], "unknown policy 'nerest'"),
    ],
)
def test_the_command_line_says_what_is_wrong_before_a_run(arguments, says, tmp_path, monkeypatch, capsys, tiny_config):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tiny.yaml").write_text(dump_record(tiny_config))
    assert train.main(arguments) == 2
    assert says in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()


def test_help_names_every_key(capsys):
    assert train.main(["--help"]) == 0
    said = capsys.readouterr().out
    assert "--environment.num-workers {None}|INT" in said
    assert "--generations INT" in said
    assert "--network.NAME" in said


def test_one_name_will_do_where_several_are_allowed():
    data = {"experiment": "one", "algorithm": "PPO", "total_steps": 8, "environment": {"id": "lidarnaut/Explore-v0"}}
    assert parse_config(data | {"evaluation": {"references": "nearest"}}, "one").evaluation.references == ("nearest",)
    assert parse_config(data | {"evaluation": {"references": True}}, "none").evaluation.references == ()


def test_a_training_needs_no_configuration_where_the_algorithm_is_given(configs):
    assert train.main(["--algorithm", "SAC", "--environment.id", "lidarnaut/ReachCrowd-v0"]) == 0
    (config,) = configs
    assert (config.algorithm, config.environment.id, config.total_steps) == ("SAC", "lidarnaut/ReachCrowd-v0", 300_000)
    assert (config.experiment, config.recipe) == ("ReachCrowd-v0", "ReachCrowd-v0")


@pytest.mark.parametrize(
    ("algorithm", "expected"),
    [
        ("RecurrentPPO", {"learning_rate": "lin_0.0007", "n_steps": 128, "policy_kwargs": {"lstm_hidden_size": 64}}),
        ("SAC", {"ent_coef": "auto_0.05", "tau": 0.02, "gradient_steps": 4, "buffer_size": 1000}),
        ("DDPG", {"action_noise": 0.1, "learning_starts": 1000}),
        ("TRPO", {"gamma": 0.5}),
    ],
)
def test_hyperparameters_are_the_projects_unless_given(algorithm, expected, tiny_data):
    given = {"total_steps": 500, "algorithm": algorithm, "hyperparameters": {"gamma": 0.5}}
    config = parse_config(tiny_data | given | {"checkpoints": {"every": 10_000}}, "mem")
    with contextlib.closing(make_vec_env(config)) as env:
        found = prepare(config, find_algorithm(algorithm), env).config.hyperparameters
    assert found.items() >= (expected | {"gamma": 0.5}).items()
    assert (found.keys() == {"gamma"}) == (algorithm == "TRPO")

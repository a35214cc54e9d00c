import copy
from pathlib import Path

import pytest

import train
from agents.config import EvolutionConfig, TrainingConfig
from envs.files import dump_record, parse_record, read_mapping, read_record

CONFIGS = sorted(
    path for path in (Path(__file__).parents[2] / "configs").glob("*.yaml") if not path.stem.startswith("arena")
)


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_configurations_of_the_project_are_valid_and_survive_being_written(path, tmp_path):
    kind = EvolutionConfig if "algorithm" in read_mapping(path) else TrainingConfig
    config = read_record(path, kind)
    assert config.experiment == path.stem
    (tmp_path / "again.yaml").write_text(dump_record(config))
    assert read_record(tmp_path / "again.yaml", kind) == config


def test_there_are_configurations():
    assert {path.stem for path in CONFIGS} >= {"demo", "rooms_small", "rooms"}


def test_numbers_in_scientific_notation_are_numbers(tmp_path):
    path = tmp_path / "a.yaml"
    path.write_text("experiment: a\ntotal_steps: 3e5\nppo: {learning_rate: 3e-4, entropy_coef: 1E-3, gamma: .9e0}\n")
    config = read_record(path, TrainingConfig)
    assert config.total_steps == 300_000
    assert isinstance(config.total_steps, int)
    assert (config.ppo.learning_rate, config.ppo.entropy_coef, config.ppo.gamma) == (3e-4, 1e-3, 0.9)


@pytest.mark.parametrize(
    ("section", "key", "value", "message"),
    [
        ("ppo", "learnig_rate", 1e-3, r"mem: unknown key 'ppo.learnig_rate' \(did you mean 'learning_rate'\?\)"),
        (None, "total_stesp", 5, r"unknown key 'total_stesp' \(did you mean 'total_steps'\?"),
        ("environment", "wrold", "rooms", r"unknown key 'environment.wrold' \(did you mean 'world'\?"),
        ("environment", "reward", {"explord": 1.0}, r"environment.reward: unknown term 'explord' \(did you mean 'expl"),
        ("ppo", "gamma", 1.5, r"ppo.gamma: Input should be less than or equal to 1, got 1.5"),
        ("ppo", "learning_rate", "fast", r"ppo.learning_rate: .*number.*, got 'fast'"),
        ("environment", "world_size", [8, -1], r"environment.world_size.1: .*greater than 0, got -1"),
        ("checkpoints", "every", 100, r"checkpoints.every is 100, but an update takes .* 128 steps"),
        ("ppo", "batch_size", 48, r"ppo.batch_size 48 does not divide .* 128"),
        (None, "experiment", "../up", r"experiment: .*pattern"),
        ("environment", "vectorization", "fork", r"vectorization: .*'native', 'sync' or 'async', got 'fork'"),
    ],
)  # fmt: skip
def test_mistakes_are_named_with_what_is_allowed(tiny_data, section, key, value, message):
    data = copy.deepcopy(tiny_data)
    (data[section] if section else data)[key] = value
    with pytest.raises(ValueError, match=message):
        parse_record(data, "mem", TrainingConfig)


def test_a_missing_key_and_an_unreadable_file_are_named(tmp_path):
    with pytest.raises(ValueError, match="mem: key 'total_steps' is missing"):
        parse_record({"experiment": "a"}, "mem", TrainingConfig)
    path = tmp_path / "a.yaml"
    for text, message in (
        ("a: [1", "expected ',' or ']'"),
        ("- 1", "must hold keys and values, got list"),
        ("experiment: a\ntotal_steps: 1\nexperiment: b", "key 'experiment' occurs twice"),
    ):
        path.write_text(text)
        with pytest.raises(ValueError, match=rf"a\.yaml(.|\n)*{message}"):
            read_record(path, TrainingConfig)
    with pytest.raises(FileNotFoundError, match=r"nothere\.yaml: no such file; there are .*a\.yaml"):
        read_record(tmp_path / "nothere.yaml", TrainingConfig)


def test_reward_terms_left_out_keep_the_weight_of_the_environment(tiny_data):
    from envs.tasks.rewards import RewardWeights

    config = parse_record({**tiny_data, "environment": {"reward": {"time": -1.0}}}, "mem", TrainingConfig)
    assert config.environment.reward["time"] == -1.0
    assert config.environment.reward["explored"] == RewardWeights().explored


def test_the_command_line_overrides_the_file_and_refuses_mistakes(tmp_path, monkeypatch, capsys, tiny_config):
    seen = {}

    def remember(config, resume):
        seen["config"] = config
        return tmp_path

    monkeypatch.setattr("agents.training.train", remember)
    path = tmp_path / "tiny.yaml"
    path.write_text(dump_record(tiny_config))
    arguments = ["--config", str(path), "--seed", "7", "--ppo.learning-rate", "1e-3", "--environment.reward.time", "-2"]
    assert train.main(arguments) == 0
    assert (seen["config"].seed, seen["config"].ppo.learning_rate) == (7, 1e-3)
    assert seen["config"].environment.reward["time"] == -2.0
    assert seen["config"].ppo.num_steps == tiny_config.ppo.num_steps
    assert train.main(["--config", str(path), "--ppo.learnin-rate", "1"]) == 2
    assert "--ppo.learning-rate" in capsys.readouterr().err
    assert train.main(["--config", str(tmp_path / "no.yaml")]) == 2
    assert "no.yaml: no such file" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ([], "--config FILE, or a run that is to go on"),
        (["--seed", "1"], "--config FILE, or a run that is to go on"),
        (["--config", ""], "unknown configuration ''"),
        (
            ["--environment.id", "lidarnaut/Navigate-v0"],
            "'lidarnaut/Navigate-v0' is not for exploration",
        ),
        (["--environment.id", "CartPole-v1"], "environment.id: 'CartPole-v1' is not for exploration"),
        (["--environment.id", "no_such_module:Mine-v0"], "No module named 'no_such_module'"),
        (["--evaluation.references", "random", "nerest"], "unknown explorer 'nerest' (did you mean 'nearest'?)"),
    ],
)
def test_the_command_line_says_what_is_wrong_before_there_is_a_run(
    tmp_path, monkeypatch, capsys, tiny_config, arguments, says
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tiny.yaml").write_text(dump_record(tiny_config))
    is_complete = "--seed" in arguments or "--config" in arguments or not arguments
    assert train.main([*([] if is_complete else ["--config", "tiny.yaml"]), *arguments]) == 2
    assert says in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("algorithm: evolutionn", "algorithm: Input should be 'evolution', got 'evolutionn'"),
        ("algorithm: evolution\nfamilies: [rooms, mase]", r"families: unknown family 'mase' (did you mean 'maze'?)"),
    ],
)
def test_mistakes_of_an_evolution_are_named(tmp_path, capsys, line, says):
    (tmp_path / "a.yaml").write_text(f"experiment: a\n{line}\n")
    assert train.main(["--config", str(tmp_path / "a.yaml")]) == 2
    assert says in capsys.readouterr().err


def test_the_old_name_of_the_vector_environment_still_works(tiny_data):
    with pytest.warns(DeprecationWarning, match="'lanes' is called 'native' now"):
        config = parse_record({**tiny_data, "environment": {"vectorization": "lanes"}}, "mem", TrainingConfig)
    assert config.environment.vectorization == "native"

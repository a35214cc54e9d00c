import re
import shutil
from pathlib import Path

import pytest

from lidarnaut.agents.checkpoint import load_checkpoint
from lidarnaut.agents.config import EvolutionConfig, parse_config
from lidarnaut.agents.frontiers.evolution import evolve
from lidarnaut.agents.resume import MAY_CHANGE
from lidarnaut.agents.run_folder import CheckpointError, find_checkpoint
from lidarnaut.agents.training import train
from lidarnaut.envs.files import dump_record, read_record
from lidarnaut.train_command import main
from tests.agents.frontiers.test_evolution import TINY as EVOLUTION

ROOT = Path(__file__).parents[2]


def files(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file() and path.name != ".lock"}


def test_the_page_about_resuming_has_the_table():
    page = (ROOT / "docs" / "guides" / "training.md").read_text()
    section = page.partition("## Keys that may change")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| `([a-z_.]+)` \|(.*)\|$", section, re.MULTILINE)
    shown = {key: [cell.strip() for cell in cells.split("|")] for key, cells in rows}
    kinds = ("training", "sweep", "evolution", "completion")
    assert shown == {key: ["yes" if kind in said else "no" for kind in kinds] for key, said in MAY_CHANGE.items()}


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"seed": 1}, "seed: 0, not 1"),
        ({"algorithm": "A2C", "hyperparameters": {"n_steps": 32}}, "algorithm: 'PPO', not"),
        ({"environment": {"id": "lidarnaut/Navigate-v0"}}, "environment.id: 'tests"),
        ({"experiment": "other"}, "experiment: 'tiny', not 'other'"),
        ({"evaluation": {"every": 256, "episodes": 2, "references": []}}, "evaluation.episodes: 3, not 2"),
        ({"evaluation": {"every": 256, "episodes": 3, "at_start": False}}, "evaluation.at_start: True, not False"),
        ({"hyperparameters": {"n_steps": 32, "ent_coef": 0.1}}, "hyperparameters.ent_coef: 'the default', not 0.1"),
        ({"hyperparameters": {"n_steps": 32, "policy_kwargs": {"ortho_init": False}}}, "hyperparameters.*ortho_init: "),
        ({"total_steps": 512}, "768 of total_steps, more than 512; keys that may .*: total_steps, "),
    ],
)
def test_a_training_that_would_mix_settings_is_refused_and_left_alone(changes, says, tiny_run, tiny_data, tmp_path):
    run = shutil.copytree(tiny_run, tmp_path / "run")
    before = files(run)
    with pytest.raises(CheckpointError, match=says):
        train(parse_config({**tiny_data, **changes}, "mem"), resume=run, trust=["tests"], progress=False)
    assert files(run) == before


def test_code_that_a_run_no_longer_names_is_trusted_on_the_command_line(tiny_data, tmp_path, capsys):
    """The checkpoint still names the code."""
    data = {**tiny_data, "environment": {**tiny_data["environment"], "reward": "tests.own_code:Circling"}}
    run = train(parse_config({**data, "total_steps": 128}, "mem"), run=tmp_path / "run", progress=False)
    words = ["--resume", str(run), "--environment.reward", "None", "--total-steps", "256", "--trust"]
    assert main([*words, "tests.agents"]) == 2
    assert "'tests.own_code:Circling', which is not part of the package" in capsys.readouterr().err
    assert main([*words, "tests"]) == 0, capsys.readouterr().err
    record = load_checkpoint(find_checkpoint(run), trust="tests").record
    assert (record.steps, record.config.environment.arguments["reward"]) == (256, None)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"sigma": 0.5}, r"sigma: 0\.06, not 0\.5"),
        ({"families": ("caves",)}, r"families: \['rooms'\], not \['caves'\]"),
        ({"tasks": 2}, "holds tasks: "),
        ({"generations": 1}, "2 of generations, more than 1; keys that may .*: generations, validate_every, num_"),
    ],
)
def test_an_evolution_that_would_mix_settings_is_refused_and_left_alone(changes, says, tmp_path):
    """Its results belong to individuals that only the previous settings reproduce."""
    (tmp_path / "config.yaml").write_text(dump_record(EvolutionConfig(**EVOLUTION, generations=3)))
    (tmp_path / "generations.csv").write_text("0,0,0,0\n" * 2)
    before = files(tmp_path)
    with pytest.raises(CheckpointError, match=says):
        evolve(EvolutionConfig(**{**EVOLUTION, "generations": 3, **changes}), resume=tmp_path, progress=False)
    assert files(tmp_path) == before
    assert read_record(tmp_path / "config.yaml", EvolutionConfig).generations == 3

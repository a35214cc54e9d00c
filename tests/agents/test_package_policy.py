import hashlib
import json
import shutil

import numpy as np
import pytest

from lidarnaut.agents.config import EvolutionConfig
from lidarnaut.agents.explorer import LearnedPolicy
from lidarnaut.agents.frontiers.evolution import evolve
from lidarnaut.agents.frontiers.score import ScoreExplorer
from lidarnaut.agents.frontiers.tasks import HELD_OUT, TRAINING_WORLDS
from lidarnaut.agents.learned import PRETRAINED, find_policy, load_policy
from lidarnaut.agents.package_policy import CHECKSUMS, MODEL_CARD, main
from lidarnaut.agents.run_folder import CheckpointError
from lidarnaut.agents.vec_env import make_env
from lidarnaut.envs.command_line import run_command
from tests.agents.frontiers.test_evolution import TINY as EVOLUTION

SHIPPED = sorted(folder for folder in PRETRAINED.iterdir() if folder.is_dir())


def check_sums(folder):
    """Compare all files, except the model card, with the checksums."""
    files = {path for path in folder.iterdir() if path.name not in (CHECKSUMS, MODEL_CARD)}
    sums = {f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}" for path in files}
    assert set((folder / CHECKSUMS).read_text().splitlines()) == sums


@pytest.mark.parametrize("folder", SHIPPED, ids=lambda folder: folder.name)
def test_what_comes_with_the_package_is_whole_and_was_trained_on_the_split(folder):
    check_sums(folder)
    assert (folder / MODEL_CARD).exists()
    if (folder / "policy.json").exists():
        record = json.loads((folder / "policy.json").read_text())
        assert tuple(record["training_worlds"]) == TRAINING_WORLDS
        assert tuple(record["held_out_worlds"]) == HELD_OUT.worlds
        assert tuple(record["held_out_robots"]) == HELD_OUT.robots
    if (folder / "held_out.yaml").exists():
        now = PRETRAINED.parent / "frontiers" / "held_out.yaml"
        assert (folder / "held_out.yaml").read_bytes() == now.read_bytes()


def test_a_run_that_is_not_there_is_one_line(tmp_path, capsys):
    with pytest.raises(SystemExit) as stop:
        run_command(main, ["/no/such/run", str(tmp_path / "folder")])
    assert stop.value.code == 2
    assert capsys.readouterr().err.partition(": ")[2].startswith("/no/such/run is not a folder")
    assert not (tmp_path / "folder").exists()


def test_a_score_is_shipped_and_its_model_card_is_kept(tmp_path):
    tiny = EvolutionConfig(**EVOLUTION, generations=1)
    run, folder = evolve(tiny, run=tmp_path / "run", progress=False), tmp_path / "tiny"
    folder.mkdir()
    (folder / MODEL_CARD).write_text("the card")
    (folder / "older").write_text("of an older policy")
    main(run, folder)
    check_sums(folder)
    files = {"policy.json", "weights.safetensors", "config.yaml", "curve.png", "curve.csv", "held_out.yaml"}
    assert {path.name for path in folder.iterdir()} == files | {CHECKSUMS, MODEL_CARD}
    assert (folder / MODEL_CARD).read_text() == "the card"
    assert isinstance(load_policy(find_policy(folder)), ScoreExplorer)


def test_a_policy_of_ppo_is_shipped_without_the_optimizer(tiny_run, tiny_config, tmp_path):
    folder = tmp_path / "twist"
    main(tiny_run, folder)
    check_sums(folder)
    files = {"checkpoint.json", "policy.safetensors", "config.yaml", "curve.png", "curve.csv"}
    assert {path.name for path in folder.iterdir()} == files | {CHECKSUMS}
    env = make_env(tiny_config.environment, "test")
    observation, _ = env.reset(seed=1)
    shipped, trained = load_policy(find_policy(folder), trust="tests"), LearnedPolicy.load(tiny_run, trust="tests")
    for explorer in (shipped, trained):
        explorer.reset(env.unwrapped.robot_params, env.unwrapped.control_period, np.random.default_rng(0))
    np.testing.assert_array_equal(shipped(observation), trained(observation))


def test_what_holds_no_policy_is_not_shipped(tiny_run, tmp_path):
    with pytest.raises(CheckpointError, match="run folder"):
        main(tmp_path, tmp_path / "twist")
    damaged = shutil.copytree(tiny_run, tmp_path / "run")
    (damaged / "learning_curve.png").unlink()
    with pytest.raises(FileNotFoundError, match=r"learning_curve\.png"):
        main(damaged, tmp_path / "twist")
    assert not (tmp_path / "twist").exists()

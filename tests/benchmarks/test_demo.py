import html
import json
import re
import sys
import time

import pytest

from lidarnaut.agents.config import TrainingConfig, change
from lidarnaut.agents.recipes import with_recipe
from lidarnaut.benchmarks.arena.runner import Evaluation
from lidarnaut.benchmarks.demo import CONFIG, RIVAL, SCENES, TRAINING, demo, describe_learning, running
from lidarnaut.envs.files import Lock, LockedError, parse_record, read_mapping
from tests.agents.tiny import tiny


@pytest.fixture
def config():
    environment = {"id": "lidarnaut/ReachCrowd-v0", "world": "hall", "num_worlds": 2, "num_workers": 0}
    return tiny(
        "PPO",
        "ReachCrowd",
        environment={**environment, "time_limit": 2.0},
        hyperparameters={"n_steps": 8, "batch_size": 16, "n_epochs": 1},
        evaluation={"every": 16, "episodes": 1, "references": ["pursuit"]},
        checkpoints={"every": 16},
    )


@pytest.fixture
def scenes():
    short = {"episodes": 1, "time_limit": 3.0}
    return [one._replace(settings=one.settings.model_copy(update=short)) for one in SCENES]


def test_the_demo_leaves_everything_and_replaces_an_earlier_one(tmp_path, monkeypatch, config, scenes, no_overview):
    describe = "lidarnaut.benchmarks.demo.describe_learning"
    monkeypatch.setattr(describe, lambda rows, task: f"{task}: {len(rows)} evaluations.")
    folder = tmp_path / "demo"
    folder.mkdir()
    (folder / "report.html").write_text("of an earlier demo")
    (tmp_path / "demo.new").mkdir()
    (tmp_path / "demo.new" / "half").write_text("of an interrupted one")
    sentence = demo(config, folder, scenes, jobs=1)
    assert sentence == f"{folder / 'report.html'}: ReachCrowd-v0: 4 evaluations."
    assert {path.name for path in tmp_path.iterdir()} == {"demo", ".lock-demo"}
    assert not (folder / "half").exists()
    assert (folder / "learning_curve.png").read_bytes().startswith(b"\x89PNG")
    report = (folder / "report.html").read_text()
    assert report.count("data:image/png") == 1
    pages = [html.unescape(page) for page in re.findall(r'<iframe srcdoc="([^"]+)"', report)]
    titles = [re.search("<title>(.*)</title>", page)[1] for page in pages]
    assert titles == ["crowd in hall", "twist in turtlebot3_house"]
    for scene in scenes:
        assert (folder / re.search(rf'href="({scene.folder}/[^"]+)"', report)[1]).exists()
        summary = json.loads((folder / scene.folder / "summary.json").read_text())
        assert list(summary) == [name.partition("=")[0] for name in scene.settings.policies]


def test_scenes_run_beside_the_training(tmp_path, scenes):
    (scene, *_), folder = scenes, tmp_path / scenes[0].folder
    with running([scene], tmp_path):
        end = time.monotonic() + 120.0
        while Evaluation(scene.settings, folder).done < len(scene.settings.policies) and time.monotonic() < end:
            time.sleep(0.5)
    evaluation = Evaluation(scene.settings, folder)
    assert evaluation.done == evaluation.total == len(scene.settings.policies)
    assert len(list(folder.rglob("*.npz"))) > 0


def test_the_demo_shortens_the_shipped_configuration():
    config = parse_record(with_recipe(change(read_mapping(CONFIG), TRAINING))[0], str(CONFIG), TrainingConfig)
    assert RIVAL in config.evaluation.references
    assert config.total_steps % config.evaluation.every == 0


def test_the_sentence_names_the_success_of_ppo_and_of_the_classic_policies():
    rows = [{"policy": policy, "steps": 0, "success": share} for policy, share in (("pursuit", 0.35), ("learned", 0.1))]
    for share in ("40%", "20%"):
        last = {"policy": "learned", "steps": 4096, "success": float(share[:-1]) / 100}
        said = f"In T, PPO reached 10% of its goals at first, {share} after 4,096 steps (pursuit 35%)."
        assert describe_learning([*rows, last], "T") == said


@pytest.mark.skipif(sys.platform == "win32", reason="there are no such locks")
def test_a_second_demo_leaves_the_first_one_alone(tmp_path, config):
    (tmp_path / "demo.new").mkdir()
    with Lock(tmp_path, "lock-demo"), pytest.raises(LockedError, match=f"{tmp_path} is in use: process"):
        demo(config, tmp_path / "demo")
    assert (tmp_path / "demo.new").exists()

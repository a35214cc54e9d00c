import html
import json
import re

import pytest

from lidarnaut.benchmarks.demo import demo, describe_learning, read_configs
from tests.agents.tiny import tiny


@pytest.fixture
def config():
    environment = {"id": "lidarnaut/ReachCrowd-v0", "world": "hall", "num_worlds": 2, "num_workers": 0}
    return tiny(
        "PPO",
        "ReachCrowd",
        environment={**environment, "time_limit": 2.0},
        hyperparameters={"n_steps": 8, "batch_size": 16, "n_epochs": 1},
        evaluation={"every": 16, "at_start": True, "episodes": 1, "references": ["pursuit"]},
        checkpoints={"every": 16},
    )


def test_the_demo_leaves_everything_and_replaces_an_earlier_one(tmp_path, monkeypatch, config, no_overview):
    describe = "lidarnaut.benchmarks.demo.describe_learning"
    monkeypatch.setattr(describe, lambda rows, task: f"{task}: {len(rows)} evaluations.")
    short = {"episodes": 1, "time_limit": 3.0}
    shipped, scenes = read_configs()
    assert shipped.total_steps % shipped.evaluation.every == 0  # it ends with an evaluation
    scenes = [(scene, settings.model_copy(update=short)) for scene, settings in scenes]
    folder = tmp_path / "demo"
    folder.mkdir()
    (folder / "half").write_text("of an earlier demo")
    sentence = demo(config, scenes, folder, jobs=1)
    assert sentence == f"{folder / 'report.html'}: ReachCrowd-v0: 4 evaluations."
    assert not (folder / "half").exists()
    assert (folder / "learning_curve.png").read_bytes().startswith(b"\x89PNG")
    report = (folder / "report.html").read_text()
    assert report.count("data:image/png") == 1
    pages = [html.unescape(page) for page in re.findall(r'<iframe srcdoc="([^"]+)"', report)]
    titles = [re.search("<title>(.*)</title>", page)[1] for page in pages]
    assert titles == ["crowd in hall", "twist in turtlebot3_house"]
    for scene, settings in scenes:
        assert (folder / re.search(rf'href="({scene.name}/[^"]+)"', report)[1]).exists()
        summary = json.loads((folder / scene.name / "summary.json").read_text())
        assert list(summary) == [name.partition("=")[0] for name in settings.policies]


def test_the_sentence_names_the_success_of_ppo_and_of_the_classic_policies():
    rows = [{"policy": policy, "steps": 0, "success": share} for policy, share in (("pursuit", 0.35), ("learned", 0.1))]
    for share in ("40%", "20%"):
        last = {"policy": "learned", "steps": 4096, "success": float(share[:-1]) / 100}
        said = f"In T, PPO reached 10% of its goals at first, {share} after 4,096 steps (pursuit 35%)."
        assert describe_learning([*rows, last], "T") == said

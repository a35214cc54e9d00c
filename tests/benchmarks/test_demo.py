import json
import sys

import pytest

from lidarnaut.benchmarks.demo import CLASSIC, LEARNED, REFERENCE, TWIST, WORLD, check_learning, demo, median_pair
from lidarnaut.envs.files import Lock, LockedError
from tests.agents.test_every_algorithm import tiny


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


def test_the_demo_leaves_everything_and_replaces_an_earlier_one(tmp_path, monkeypatch, config):
    monkeypatch.setattr("lidarnaut.benchmarks.demo.NUM_FRAMES", 3)
    monkeypatch.setattr(
        "lidarnaut.benchmarks.demo.check_learning", lambda rows, task: f"{task}: {len(rows)} evaluations."
    )
    folder = tmp_path / "demo"
    folder.mkdir()
    (folder / "report.html").write_text("of an earlier demo")
    (tmp_path / "demo.new").mkdir()
    (tmp_path / "demo.new" / "half").write_text("of an interrupted one")
    sentence = demo(config, folder, episodes=1, physics="kinematic", time_limit=3.0, jobs=1)
    assert {path.name for path in tmp_path.iterdir()} == {"demo", ".lock-demo"}
    assert not (folder / "half").exists()
    assert set(json.loads((folder / "summary.json").read_text())) == {REFERENCE, CLASSIC, LEARNED, TWIST}
    assert (folder / "exploration.gif").read_bytes().startswith(b"GIF")
    assert (folder / "exploration.gif").stat().st_size < 5_000_000
    for picture in ("paths.png", "learning_curve.png", f"map_{WORLD}_{LEARNED}.png"):
        assert (folder / picture).read_bytes().startswith(b"\x89PNG")
    assert (folder / "report.html").read_text().count("data:image/gif") == 1
    assert sentence.startswith(f"{folder / 'report.html'}: ReachCrowd-v0: 3 evaluations. Times")
    assert sentence.endswith(f"as shares of nearest's (median start): {CLASSIC} 1.00, {LEARNED} 1.00, {TWIST} 1.00.")


def test_a_training_that_does_not_improve_fails_and_leaves_an_earlier_demo(tmp_path, config):
    (tmp_path / "demo").mkdir()
    with pytest.raises(
        RuntimeError, match=r"in ReachCrowd-v0, PPO reached 0% .* and 0% after .* more than pursuit, 0%"
    ):
        demo(config, tmp_path / "demo")
    assert (tmp_path / "demo").exists()
    assert (tmp_path / "demo.new" / "training" / "learning_curve.png").exists()


def test_a_training_counts_if_it_gets_above_pursuit():
    rows = [{"policy": policy, "steps": 0, "success": share} for policy, share in (("pursuit", 0.35), ("learned", 0.1))]
    improved = [*rows, {"policy": "learned", "steps": 4096, "success": 0.4}]
    assert (
        check_learning(improved, "T")
        == "In T, PPO reached 10% of its goals at first, 40% after 4,096 steps (pursuit 35%)."
    )
    for share in (0.35, float("nan")):
        improved[-1]["success"] = share
        with pytest.raises(RuntimeError, match=r"10% of its goals before and .* more than pursuit, 35%"):
            check_learning(improved, "T")


@pytest.mark.skipif(sys.platform == "win32", reason="there are no such locks")
def test_a_second_demo_leaves_the_first_one_alone(tmp_path, config):
    (tmp_path / "demo.new").mkdir()
    with Lock(tmp_path, "lock-demo"), pytest.raises(LockedError, match=f"{tmp_path} is in use: process"):
        demo(config, tmp_path / "demo")
    assert (tmp_path / "demo.new").exists()


def test_the_median_start_is_that_of_the_ratio_of_times():
    times = {TWIST: (30.0, 90.0, float("inf")), REFERENCE: (60.0, 100.0, 50.0)}
    rows = [
        {"policy": policy, "world": WORLD, "robot": "r", "physics": "p", "slam": "s", "seed": seed}
        | {"time_to_95": time, "time_limit": 200.0}
        for policy, values in times.items()
        for seed, time in enumerate(values)
    ]
    ratio, (own, other) = median_pair(rows)
    assert ratio == 0.9
    assert (own["policy"], own["seed"], other["policy"], other["seed"]) == (TWIST, 1, REFERENCE, 1)
    assert median_pair(rows[:1] + rows[2:])[0] == 4.0  # of the two that are left, the slower one

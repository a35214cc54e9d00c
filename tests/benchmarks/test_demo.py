import json
import sys

import pytest

from agents.config import EvolutionConfig
from benchmarks.demo import CLASSIC, FRESH, LEARNED, WORLD, demo, median_pair
from envs.files import Lock, LockedError

TINY = {"algorithm": "evolution", "experiment": "tiny", "generations": 1, "population": 4, "tasks": 1, "num_workers": 1}
TINY |= {"validation_tasks": 1, "families": ("rooms",)}


def test_the_demo_leaves_everything_and_replaces_an_earlier_one(tmp_path, monkeypatch):
    monkeypatch.setattr("benchmarks.demo.NUM_FRAMES", 3)
    folder = tmp_path / "demo"
    folder.mkdir()
    (folder / "report.html").write_text("of an earlier demo")
    (tmp_path / "demo.new").mkdir()
    (tmp_path / "demo.new" / "half").write_text("of an interrupted one")
    sentence = demo(EvolutionConfig(**TINY), folder, episodes=1, physics="kinematic", time_limit=3.0, jobs=1)
    assert {path.name for path in tmp_path.iterdir()} == {"demo", ".lock-demo"}
    assert not (folder / "half").exists()
    assert set(json.loads((folder / "summary.json").read_text())) == {LEARNED, CLASSIC, FRESH}
    assert (folder / "exploration.gif").read_bytes().startswith(b"GIF")
    assert (folder / "exploration.gif").stat().st_size < 5_000_000
    for picture in ("paths.png", "learning_curve.png", f"map_{WORLD}_{LEARNED}.png"):
        assert (folder / picture).read_bytes().startswith(b"\x89PNG")
    assert (folder / "report.html").read_text().count("data:image/gif") == 1
    assert sentence.startswith(f"{folder / 'report.html'}: to 95 % of {WORLD} the shipped explorer took 1.00")


@pytest.mark.skipif(sys.platform == "win32", reason="there are no such locks")
def test_a_second_demo_leaves_the_first_one_alone(tmp_path):
    (tmp_path / "demo.new").mkdir()
    with Lock(tmp_path, "lock-demo"), pytest.raises(LockedError, match=f"{tmp_path} is in use: process"):
        demo(EvolutionConfig(**TINY), tmp_path / "demo")
    assert (tmp_path / "demo.new").exists()


def test_the_median_start_is_that_of_the_ratio_of_times():
    times = {LEARNED: (30.0, 90.0, float("inf")), CLASSIC: (60.0, 100.0, 50.0)}
    rows = [
        {"policy": policy, "world": WORLD, "robot": "r", "physics": "p", "slam": "s", "seed": seed}
        | {"time_to_95": time, "time_limit": 200.0}
        for policy, values in times.items()
        for seed, time in enumerate(values)
    ]
    ratio, (own, other) = median_pair(rows)
    assert ratio == 0.9
    assert (own["policy"], own["seed"], other["policy"], other["seed"]) == (LEARNED, 1, CLASSIC, 1)
    assert median_pair(rows[:1] + rows[2:])[0] == 4.0  # of the two that are left, the slower one

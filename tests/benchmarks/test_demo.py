import json

from agents.config import TrainingConfig
from benchmarks.demo import WORLD, demo

TINY = {
    "experiment": "tiny",
    "total_steps": 64,
    "num_envs": 2,
    "environment": {"world": "rooms", "world_size": (6, 6), "physics": "kinematic", "time_limit": 4},
    "ppo": {"num_steps": 32, "batch_size": 32, "num_epochs": 1},
    "evaluation": {"episodes": 1, "references": []},
    "checkpoints": {"every": 64},
}


def test_the_demo_leaves_everything_and_replaces_an_earlier_one(tmp_path):
    folder = tmp_path / "demo"
    folder.mkdir()
    (folder / "report.html").write_text("of an earlier demo")
    (tmp_path / "demo.new").mkdir()
    (tmp_path / "demo.new" / "half").write_text("of an interrupted one")
    sentence = demo(TrainingConfig(**TINY), folder, episodes=1, physics="kinematic", time_limit=3.0, jobs=1)
    assert list(tmp_path.iterdir()) == [folder]
    assert not (folder / "half").exists()
    assert set(json.loads((folder / "summary.json").read_text())) == {"ppo", "frontier", "random"}
    for gif in ("exploration.gif", "exploration_frontier.gif"):
        assert (folder / gif).read_bytes().startswith(b"GIF")
        assert (folder / gif).stat().st_size < 5_000_000
    for picture in ("learning_curve.png", f"map_{WORLD}_ppo.png"):
        assert (folder / picture).read_bytes().startswith(b"\x89PNG")
    report = (folder / "report.html").read_text()
    assert report.count("data:image/gif") == 2
    assert sentence.startswith(f"{folder / 'report.html'}: the trained explorer saw")

from lidarnaut.agents.curves import read_evaluations
from lidarnaut.agents.evaluation import Evaluator
from lidarnaut.agents.training import train
from tests.agents.tiny import tiny


def test_references_are_measured_once_at_the_end_in_their_order(tmp_path, monkeypatch):
    environment = {"id": "lidarnaut/ReachGoal-v0", "world": "hall", "world_size": [6, 6], "time_limit": 1.0}
    evaluation = {"every": 16, "episodes": 1, "test_episodes": 2, "references": ["pursuit", "random"]}
    ran, make = [], Evaluator.make_reference
    monkeypatch.setattr(Evaluator, "make_reference", lambda self, name: ran.append(name) or make(self, name))
    config = tiny("PPO", "Explore", environment={**environment, "num_workers": 0}, evaluation=evaluation)
    folder = train(config, run=tmp_path / "run", progress=False)
    assert ran == ["pursuit", "random"] * 2 + ["pursuit"] * 2 + ["random"] * 2  # names, first steps, episodes
    rows = read_evaluations(folder)
    assert [(row["policy"], row["split"], row["steps"]) for row in rows] == [
        ("pursuit", "test", 0), ("random", "test", 0), ("learned", "validation", 0), ("learned", "validation", 16),
        ("learned", "test", 16),
    ]  # fmt: skip
    assert [len(row["scores"].split()) for row in rows] == [2, 2, 1, 1, 2]

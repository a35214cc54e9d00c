import json

import pytest

from lidarnaut.agents.recipes import RECIPES
from lidarnaut.benchmarks import recipes
from lidarnaut.benchmarks.recipes import main

SMALL = """\
# Goals in a hall.
# 2 s on two cores.
total_steps: 16
num_envs: 2
algorithm: PPO
environment: {world: hall, world_size: [6, 6], time_limit: 1, num_workers: 0, observations: [goal]}
hyperparameters: {n_steps: 4, batch_size: 4}
evaluation: {every: 8, episodes: 2, references: [random, pursuit]}
checkpoints: {every: 8}
"""


@pytest.fixture
def small(tmp_path, monkeypatch):
    path = tmp_path / "small.yaml"
    path.write_text(SMALL)
    monkeypatch.setattr(recipes, "RECIPES", {"ReachGoal-v0": path, "ReachHouse-v0": path})
    monkeypatch.setitem(RECIPES, "ReachGoal-v0", path)
    monkeypatch.setitem(RECIPES, "ReachHouse-v0", path)
    return tmp_path


def test_the_page_has_curves_results_and_classic_policies_of_each_recipe(small, monkeypatch):
    out, docs = small / "runs", small / "docs"
    docs.mkdir()
    main(("ReachGoal-v0",), seeds=2, out=out, docs=docs, test_episodes=3)
    page = (docs / "recipes.md").read_text()
    goal, house = page.split("## ReachGoal-v0")[1].split("## ReachHouse-v0")
    assert "Goals in a hall. 2 s on two cores." in goal
    for row in ("| PPO |", "| pursuit |", "| random |"):
        assert row in goal
    assert "Not measured yet" in house
    assert (docs / "recipes" / "ReachGoal-v0.png").read_bytes().startswith(b"\x89PNG")
    rows = json.loads((docs / "recipes" / "ReachGoal-v0.json").read_text())
    found = [(row["seed"], row["policy"], row["split"], len(row["scores"].split())) for row in rows]
    assert found == [
        (0, "random", "test", 3), (0, "pursuit", "test", 3), (0, "learned", "test", 3), (1, "learned", "test", 3),
    ]  # fmt: skip
    # Nothing is trained again, and sections of runs that are not there are kept.
    monkeypatch.setattr("lidarnaut.agents.learning.run_training", None)
    main(("ReachGoal-v0",), seeds=2, out=out, docs=docs, test_episodes=3)
    assert (docs / "recipes.md").read_text() == page
    monkeypatch.setattr(recipes, "train", lambda *_, **__: None)
    main(out=small / "others", docs=docs)
    assert (docs / "recipes.md").read_text() == page
    assert (docs / "recipes" / "ReachGoal-v0.png").exists()
    with pytest.raises(ValueError, match=r"unknown recipe 'ReachGola-v0' \(did you mean 'ReachGoal-v0'\?\)"):
        main(("ReachGola-v0",))

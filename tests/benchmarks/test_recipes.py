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
    for row in ("| PPO |", "| pursuit |", "| random |", "| last checkpoint |"):
        assert row in goal
    assert "Not measured yet" in house
    assert (docs / "recipes" / "ReachGoal-v0.png").read_bytes().startswith(b"\x89PNG")
    rows = json.loads((docs / "recipes" / "ReachGoal-v0.json").read_text())
    assert [(row["seed"], row["policy"], row.get("checkpoint", "")) for row in rows] == [
        (0, "random", ""), (0, "pursuit", ""), (0, "learned", "best"), (0, "learned", "last"),
        (1, "learned", "best"), (1, "learned", "last"),
    ]  # fmt: skip
    assert {(row["split"], len(row["scores"].split())) for row in rows} == {("test", 3)}
    # Nothing is trained or measured again.
    monkeypatch.setattr("lidarnaut.agents.learning.run_training", None)
    monkeypatch.setattr(recipes, "Evaluator", None)
    main(("ReachGoal-v0",), seeds=2, out=out, docs=docs, test_episodes=3)
    assert (docs / "recipes.md").read_text() == page
    # Sections of runs that are not there are kept.
    main(("ReachHouse-v0",), seeds=1, out=small / "others", docs=docs, train=False)
    assert (docs / "recipes.md").read_text() == page
    assert (docs / "recipes" / "ReachGoal-v0.png").exists()


def test_an_unknown_recipe_is_named():
    with pytest.raises(ValueError, match=r"unknown recipe 'ReachGola-v0' \(did you mean 'ReachGoal-v0'\?\)"):
        main(("ReachGola-v0",))

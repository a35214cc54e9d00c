from pathlib import Path

import numpy as np
import pytest

from lidarnaut.agents.config import CONFIGURATIONS
from lidarnaut.agents.seeds import expand, read_members
from lidarnaut.benchmarks import algorithms
from lidarnaut.benchmarks.algorithms import TaskResults, configurations, difference, overview, read_task, task_section
from lidarnaut.envs.measures import REACH

TINY = """
base:
  {recipe: null, seeds: [0], total_steps: 16, num_envs: 2, hyperparameters: {batch_size: 4},
   environment: {num_workers: 0, time_limit: 1.0, world: rooms, world_size: [6, 6], slam: truth},
   evaluation: {every: 16, episodes: 2}, network: {features: 8, channels: 2, hidden: 8}}
tasks:
  Rooms:
    {algorithms: [PPO, SAC], environment: {id: lidarnaut/Explore-v0}, evaluation: {references: [random, nearest]}}
  Goals:
    {algorithms: [PPO], environment: {id: lidarnaut/ReachGoal-v0}, evaluation: {references: [random, pursuit]}}
algorithms:
  PPO: {algorithm: PPO, hyperparameters: {n_steps: 4}}
  SAC: {algorithm: SAC, hyperparameters: {train_freq: 4, learning_starts: 4}}
"""


def make_task(**scores):
    """Task of two seeds and forty episodes: `random` reaches no goal, `pursuit` half of them."""
    half = (np.arange(40) % 2.0)[None]
    return TaskResults(
        name="Halls",
        measure=REACH[0],
        steps={name: np.array([0, 100]) for name in scores},
        scores={name: np.stack([np.zeros((2, 40)), values]) for name, values in scores.items()},
        results=scores,
        references={"pursuit": half, "random": np.zeros((1, 40))},
        times=dict.fromkeys(scores, 9.0),
    )


def test_a_task_says_who_is_above_random_and_below_the_classic():
    half = (np.arange(40) % 2.0)[None]
    task = make_task(PPO=np.ones((2, 40)), SAC=np.repeat(half, 2, axis=0), TQC=np.zeros((2, 40)))
    text, picture, table = task_section(task).parts
    assert text == (
        "Above random: PPO, SAC. Not distinguishable from random: TQC. Above the best classic policy, pursuit: PPO. "
        "Not distinguishable from the best classic policy, pursuit: SAC. Below the best classic policy, pursuit: TQC."
    )
    assert picture.content.startswith(b"\x89PNG")
    rows = {line[0].text: [cell.text for cell in line[1:]] for line in table.lines}
    assert rows["PPO"] == ["100.0", "+100.0", "+50.0", "2", "100", "9"]
    assert rows["pursuit"][0] == "50.0"
    _, glance = overview([task]).parts
    ranks = {"PPO": "2.00", "SAC": "1.00", "TQC": "0.00"}
    assert [[cell.text for cell in line] for line in glance.lines] == [[*rank, "1", "2"] for rank in ranks.items()]
    task = make_task(PPO=np.repeat(half + 0.1, 2, axis=0))
    assert difference(task, "PPO", "pursuit")[:3] == pytest.approx((0.1, 0.1, 0.1))  # in the same episodes


def test_tasks_and_algorithms_are_trained_once_and_become_a_page(tmp_path, monkeypatch):
    (tmp_path / "plan.yaml").write_text(TINY)
    folders = {"out": tmp_path / "runs", "docs": tmp_path / "docs"}
    algorithms.main(tmp_path / "plan.yaml", **folders)
    page = (tmp_path / "docs" / "algorithms.md").read_text()
    assert {path.stem for path in (tmp_path / "docs" / "algorithms").iterdir()} == {"Rooms", "Goals"}
    assert page.count("the best classic policy, nearest") >= 1
    assert page.count("the best classic policy, pursuit") >= 1
    members = [member for name in ("PPO", "SAC") for member in read_members(tmp_path / "runs" / "Rooms" / name)]
    assert [bool(member.config.evaluation.references) for member in members] == [True, False]
    task = read_task("Rooms", members)
    assert (task.scores["SAC"].shape, set(task.references)) == ((1, 1, 2), {"random", "nearest"})
    monkeypatch.setattr("lidarnaut.agents.learning.run_training", None)
    algorithms.main(tmp_path / "plan.yaml", **folders)
    assert (tmp_path / "docs" / "algorithms.md").read_text() == page


def test_the_plan_of_the_documentation_is_valid():
    plan = list(configurations(CONFIGURATIONS / "algorithms.yaml"))
    assert len({(task, algorithm) for task, algorithm, _ in plan}) == len(plan) == 30
    for task, _, data in plan:
        members = expand(data | {"recipe": None}, task, Path(task))
        assert [member.config.seed for member in members] == [0, 1, 2]

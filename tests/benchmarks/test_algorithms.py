import numpy as np
import pytest
import yaml

from lidarnaut.agents.config import find_configuration
from lidarnaut.agents.study import run_study
from lidarnaut.benchmarks import algorithms
from lidarnaut.benchmarks.algorithms import TaskResults, difference, overview, task_section
from lidarnaut.envs.measures import REACH

ENVIRONMENT = {"num_workers": 0, "time_limit": 1.0, "world": "rooms", "world_size": [6, 6], "slam": "truth"}
ROOMS = {"environment": {"id": "lidarnaut/Explore-v0"}, "evaluation": {"references": ["random", "nearest"]}}
GOALS = {"environment": {"id": "lidarnaut/ReachGoal-v0"}, "evaluation": {"references": ["random", "pursuit"]}}
PPO = {"algorithm": "PPO", "hyperparameters": {"n_steps": 4}}
SAC = {"algorithm": "SAC", "hyperparameters": {"train_freq": 4, "learning_starts": 4}}
TINY = {"experiment": "tiny", "recipe": None, "total_steps": 16, "num_envs": 2, "seeds": [0]}
TINY |= {"environment": ENVIRONMENT, "evaluation": {"every": 16, "episodes": 2}}
TINY |= {"hyperparameters": {"batch_size": 4}, "network": {"features": 8, "channels": 2, "hidden": 8}}
TINY |= {"sweep": {"task": {"Rooms": ROOMS, "Goals": GOALS}, "algorithm": {"PPO": PPO, "SAC": SAC}}}


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
        missing=0,
    )


def test_differences_are_those_in_the_same_episodes():
    half = (np.arange(40) % 2.0)[None]
    task = make_task(PPO=np.repeat(half + 0.1, 2, axis=0))
    assert difference(task, "PPO", "pursuit")[:3] == pytest.approx((0.1, 0.1, 0.1))


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


def test_a_sweep_becomes_a_page_whether_all_some_or_none_of_it_is_done(tmp_path):
    folder = run_study(TINY, "mem", resume=tmp_path / "sweep", progress=False)
    algorithms.main(folder, docs=tmp_path / "docs")
    page = (tmp_path / "docs" / "algorithms.md").read_text()
    assert {path.stem for path in (tmp_path / "docs" / "algorithms").iterdir()} == {"Rooms", "Goals"}
    assert page.count("the best classic policy, nearest") >= 1
    assert page.count("the best classic policy, pursuit") >= 1
    tasks = algorithms.read_tasks(folder / "sweep.yaml")
    assert [task.scores["SAC"].shape for task in tasks] == [(2, 1, 2)] * 2
    assert [set(task.references) for task in tasks] == [{"random", "nearest"}, {"random", "pursuit"}]

    (folder / "sweep.yaml").write_text(yaml.safe_dump(TINY | {"total_steps": 32, "seeds": [0, 1]}))
    (later,) = {task.missing for task in algorithms.read_tasks(folder / "sweep.yaml")}
    assert later == 4
    algorithms.main(find_configuration("algorithms", "experiment"), docs=tmp_path / "docs")
    page = (tmp_path / "docs" / "algorithms.md").read_text()
    assert "No training run is finished yet." in page
    assert page.count("Not measured yet: 12 training runs are missing.") == 7
    assert page.count("Not measured yet: 6 training runs are missing.") == 1
    assert not list((tmp_path / "docs" / "algorithms").iterdir())

"""User-defined parts of the examples; docs/guides/customize/index.md has the table of parts."""

import csv
import sys
from pathlib import Path

import gymnasium
import pytest
import yaml

import lidarnaut  # noqa: F401  (registers the environments)
from lidarnaut.evaluate_command import main as evaluate
from lidarnaut.train_command import main as train
from tests.benchmarks.explorations import read_rows

EXAMPLES = Path(__file__).parents[2] / "examples"
TASK = "own_task:own_task/ReachGoal-v0"
OWN = {"world": "own_map:draw_world", "robot": "own_robot:ROBOT", "sensors": ["own_sensor:Beacons"]}
OWN |= {"reward": "own_reward:Careful", "slam": "own_slam:Forgetful"}
OWN |= {"observations": {"motion": None, "beacons": None, "sectors": "own_observation:Sectors"}}
TRAINING = {"recipe": None, "total_steps": 16, "num_envs": 2, "algorithm": "own_algorithm:FadingPPO"}
TRAINING |= {"hyperparameters": {"n_steps": 8, "batch_size": 16, "n_epochs": 1, "first_ent_coef": 0.02}}
TRAINING |= {"evaluation": {"episodes": 1, "references": ["random"]}}


@pytest.fixture(autouse=True)
def in_examples(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(str(EXAMPLES))
    monkeypatch.chdir(tmp_path)
    yield
    for path in EXAMPLES.glob("own_*.py"):
        sys.modules.pop(path.stem, None)


def train_on(environment, **changes):
    settings = {"num_workers": 0, "time_limit": 2.0, **environment}
    config = {**TRAINING, **changes, "experiment": "own", "environment": settings}
    Path("own.yaml").write_text(yaml.safe_dump(config))
    assert train(["--config", "own.yaml"]) == 0
    return next(Path("runs").glob("own__*"))


def test_make_and_make_vec_take_all_parts():
    env = gymnasium.make("lidarnaut/Explore-v0", physics="kinematic", **OWN)
    observation, _ = env.reset(seed=0)
    *_, info = env.step(env.action_space.sample())
    shapes = {name: part.shape for name, part in observation.items()}
    assert shapes == {"motion": (6,), "beacons": (3,), "sectors": (8,)}
    assert "careful" in info["rewards"]
    assert (env.unwrapped.world.name, env.unwrapped.robot_params.name) == ("my_hall", "my_robot")
    env.close()
    env = gymnasium.make_vec("lidarnaut/Explore-v0", num_envs=2, num_workers=1, **OWN)
    assert env.reset(seed=0)[0]["sectors"].shape == (2, 8)
    env.step(env.action_space.sample())
    env.close()


def test_train_takes_all_parts_with_an_algorithm_and_evaluate_takes_them_with_the_result():
    references = ["own_explorer:largest", "own_explorer:Circling"]
    run = train_on(OWN, evaluation={"episodes": 1, "references": references})
    with open(run / "evaluations.csv", newline="") as file:
        assert {*references, "learned"} <= {row["policy"] for row in csv.DictReader(file)}
    options = ["--worlds", OWN["world"], "--robots", OWN["robot"], "--slam", OWN["slam"], "--physics", "kinematic"]
    for name in ("sensors", "reward", "observations"):
        value = yaml.safe_dump(OWN[name], default_flow_style=True).partition("\n")[0]
        options += [f"--arguments.{name}", value]
    options += ["--policies", "own_explorer:largest", f"learned:{run}", "--episodes", "1", "--time-limit", "3"]
    options += ["--trust", "own_algorithm", "own_explorer"]
    assert evaluate([*options, "--out", "results"]) == 0
    rows = read_rows(Path("results"))
    assert {row["world"] for row in rows} == {OWN["world"]}
    assert len(rows) == 2


def test_train_and_evaluate_take_a_task():
    run = train_on({"id": TASK, "slam": "truth"})
    policies = "pursuit", "dwb", f"learned:{run}"
    options = ["--id", TASK, "--policies", *policies, "--physics", "kinematic", "--episodes", "1", "--record"]
    options += ["--arguments.world_size", "[8.0, 8.0]", "--trust", "own_algorithm"]
    assert evaluate([*options, "--out", "results"]) == 0
    rows = read_rows(Path("results"))
    assert [row["end_reason"] for row in rows[:2]] == ["reached"] * 2
    assert [(row["policy"], row["world"]) for row in rows] == [(name, "rooms") for name in policies]
    assert Path("results", "players").exists()

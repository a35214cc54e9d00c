import logging
import os
import subprocess
import sys
from pathlib import Path

import gymnasium
import pytest
import yaml

from lidarnaut.agents.config import TrainingConfig, parse_config
from lidarnaut.agents.evaluation import evaluation_environment
from lidarnaut.agents.recipes import RECIPES, find_recipe, with_recipe
from lidarnaut.agents.training import train
from lidarnaut.envs import ENVIRONMENTS, register
from lidarnaut.envs.files import read_mapping, read_record
from lidarnaut.envs.task import Rewards
from lidarnaut.envs.tasks.reach_goal import ReachGoal
from tests.test_contract import TASKS

REACH = "lidarnaut/ReachGoal-v0"
WEIGHTS = {"time": -4.0}


class Polite(Rewards):
    changes = {"collision": -9.0}


def merged(**data):
    return with_recipe(data)[0]


def given(id=REACH, **arguments):
    return {"id": id, **arguments}


@pytest.mark.parametrize("id", ENVIRONMENTS)
def test_every_id_has_a_recipe_that_leaves_the_world_of_the_id(id):
    name, fixed = find_recipe(id)
    config = parse_config(merged(environment={"id": id}), id)
    assert isinstance(config, TrainingConfig)
    assert (config.environment.id, config.recipe, config.experiment) == (id, name, name)
    assert not fixed.keys() & {*config.environment.arguments, *config.evaluation.environment}
    if "Frontiers" not in id:
        other = parse_config(merged(environment={"id": id}, algorithm="SAC"), id)
        assert set(other.hyperparameters) <= {"gamma"}


@pytest.mark.parametrize("name", RECIPES)
def test_a_recipe_says_what_it_takes_and_trains_two_updates(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    recipe = read_mapping(RECIPES[name])
    assert not recipe.keys() & {"experiment", "seed", "recipe"}
    assert "minutes on two cores" in RECIPES[name].read_text().partition("total_steps")[0]
    environment = {"id": f"lidarnaut/{name}", "num_workers": 0, "time_limit": 2.0}
    if "num_worlds" in recipe.get("environment", {}):
        environment["num_worlds"] = 4
    if name == "Track-v0":
        environment |= {key: TASKS["Track"][key] for key in ("world", "robot", "path", "map_resolution")}
    data = {"environment": environment, "num_envs": 4, "total_steps": 32, "checkpoints": {"every": 16}}
    data |= {"hyperparameters": {"n_steps": 4, "batch_size": 8}}
    data |= {"evaluation": {"episodes": 1, "test_episodes": 1, "references": []}}
    run = train(data, progress=False)
    config = read_record(run / "config.yaml", TrainingConfig)
    assert (config.recipe, config.environment.id, config.algorithm) == (name, f"lidarnaut/{name}", recipe["algorithm"])
    assert [path.name for path in sorted((run / "checkpoints").glob("step_*"))][-1] == "step_000000032"


def test_the_configuration_has_precedence_key_by_key():
    plain = merged(environment=given())
    own = merged(
        environment=given(time_limit=9, reward={"time": -1.0}, people={"attentive": 0.0}, observations={"goal": None}),
        hyperparameters={"gamma": 0.5},
        evaluation={"references": ["random"], "environment": {"people": None}},
        num_envs=8,
    )
    assert own["hyperparameters"] == plain["hyperparameters"] | {"gamma": 0.5}
    assert own["evaluation"]["every"] == plain["evaluation"]["every"]
    assert (own["evaluation"]["references"], own["num_envs"]) == (["random"], 8)
    environment = own["environment"]
    assert environment["reward"] == plain["environment"]["reward"] | {"time": -1.0}
    assert environment["people"] == plain["environment"]["people"] | {"attentive": 0.0}
    assert (environment["time_limit"], environment["world"]) == (9, plain["environment"]["world"])
    # Observations are replaced, in evaluations as well.
    assert environment["observations"] == {"goal": None}
    assert "observations" not in own["evaluation"]["environment"]
    assert own["evaluation"]["environment"]["people"] is None


def test_a_given_world_or_robot_is_not_replaced_in_evaluations_or_by_lists_of_robots():
    own = merged(environment=given(world="house.yaml", robot="jackal"))
    assert "robots" not in own["environment"]
    assert not {"world", "robot", "robots"} & own["evaluation"]["environment"].keys()
    crowd = merged(environment=given("lidarnaut/ReachCrowd-v0", people={"attentive": 1.0}))
    assert crowd["evaluation"]["environment"]["people"] == {"number": 20, "attentive": 1.0}
    assert crowd["evaluation"]["environment"]["world_size"] == [12.0, 12.0]
    other = merged(environment=given("lidarnaut/ExploreFrontiersAbstract-v0", world="turtlebot3_world"))
    assert "world_size" not in other["environment"]


def test_a_class_of_rewards_starts_from_the_weights_of_the_recipe():
    name, usual = "tests.agents.test_recipes:Polite", merged(environment=given())["environment"]["reward"]
    for reward in (name, {"class": name}):
        own, said = with_recipe({"environment": given(reward=reward)})
        kept = {term: weight for term, weight in usual.items() if term != "collision"}
        assert own["environment"]["reward"] == kept | {"class": name}
        assert f"environment.reward.progress {usual['progress']}" in said
        assert "changed by you: environment.reward.class; does not apply, so that defaults hold: environment.re" in said
    env = gymnasium.make(REACH, reward=own["environment"]["reward"])
    assert env.unwrapped.task.rewards.weights == ReachGoal.weights | usual | Polite.changes
    assert merged(environment=given(reward={"class": name, "time": -3}))["environment"]["reward"]["time"] == -3
    assert merged(environment=given(reward=f"{__name__}:WEIGHTS"))["environment"]["reward"] == usual | WEIGHTS
    track = merged(environment=given("lidarnaut/Track-v0", reward=name))  # a recipe without weights
    assert track["environment"]["reward"] == {"class": name}
    assert merged(environment=given(reward=None))["environment"]["reward"] is None


@pytest.mark.parametrize(
    ("changes", "limit", "tested"),
    [
        ({"environment": given(robot="jackal")}, 60, 60),
        ({"environment": given(world="turtlebot3_house")}, None, None),
        ({"environment": given(world="turtlebot3_house", time_limit=9)}, 9, 9),
        ({"environment": given(), "evaluation": {"environment": {"world": "turtlebot3_house"}}}, 60, None),
        ({"environment": given(time_limit=9), "evaluation": {"environment": {"world": "turtlebot3_house"}}}, 9, 9),
        ({"environment": given(), "evaluation": {"environment": {"world": "hall", "time_limit": 8}}}, 60, 8),
    ],
)
def test_the_time_limit_of_a_recipe_belongs_to_its_worlds(changes, limit, tested):
    data, said = with_recipe({"environment": given(), **changes})
    config = parse_config(data, "a")
    assert config.environment.arguments.get("time_limit") == limit
    assert evaluation_environment(config).arguments.get("time_limit") == tested
    assert ("does not apply, so that defaults hold: environment.time_limit" in said) == (limit is None)


@pytest.mark.parametrize(
    ("changes", "evaluations", "checkpoints"),
    [
        ({}, 200_000, 200_000),
        ({"total_steps": 60_000}, 15_000, 15_000),
        ({"total_steps": 20_000}, 8192, 8192),  # steps of an update
        ({"total_steps": 900_000}, 200_000, 200_000),
        ({"total_steps": 60_000, "evaluation": {"every": 30_000}}, 30_000, 15_000),
        ({"algorithm": "SAC", "total_steps": 100_000}, 25_000, 25_000),
    ],
)
def test_short_trainings_have_four_validations_and_checkpoints_unless_others_are_given(
    changes, evaluations, checkpoints
):
    data, said = with_recipe({"environment": given(), **changes})
    assert (data["evaluation"]["every"], data["checkpoints"]["every"]) == (evaluations, checkpoints)
    assert f"checkpoints.every {checkpoints}" in said


ALL = {"learning_rate", "n_steps", "batch_size", "n_epochs", "gamma", "ent_coef", "target_kl"}
KEPT = {"PPO": ALL, "MaskablePPO": ALL, "RecurrentPPO": ALL, "stable_baselines3:PPO": ALL}
KEPT |= {"A2C": {"gamma", "n_steps"}, "TRPO": {"gamma", "n_steps"}, "SAC": {"gamma"}, "CrossQ": {"gamma"}}


@pytest.mark.parametrize(("algorithm", "kept"), KEPT.items())
def test_another_algorithm_keeps_what_applies_to_it(algorithm, kept):
    plain, own = merged(environment=given()), merged(environment=given(), algorithm=algorithm)
    assert own["hyperparameters"].keys() == kept
    assert {key: plain[key] for key in ("environment", "evaluation", "checkpoints")}.items() <= own.items()
    is_off_policy = kept == {"gamma"}
    assert own["num_envs"] == (64 if is_off_policy else plain["num_envs"])
    assert own["total_steps"] == (300_000 if is_off_policy else plain["total_steps"])


@pytest.mark.parametrize(
    ("id", "changes", "kept"),
    [
        ("Explore", {}, {"prior"}),
        ("Explore", {"algorithm": "RecurrentPPO"}, set()),
        ("Explore", {"environment": {"observations": ["scan", "motion"]}}, set()),
        ("Explore", {"environment": {"observations": ["trajectories", "carrot"]}}, {"prior"}),
        ("Sweep", {"algorithm": "A2C"}, {"speed"}),
        ("Sweep", {"algorithm": "SAC"}, set()),
        ("ExploreFrontiers", {}, {"prior"}),
        ("ExploreFrontiers", {"algorithm": "MaskablePPO"}, set()),
    ],
)
def test_network_keys_stay_as_far_as_the_network_accepts_them(id, changes, kept):
    data = {**changes, "environment": given(f"lidarnaut/{id}-v0", **changes.get("environment", {}))}
    own = merged(**data)
    assert own["network"].keys() == kept
    # What the user sets stays, and is an error where it does not fit.
    assert merged(**data, network={"log_std": -1.0})["network"]["log_std"] == -1.0


def test_null_chooses_no_recipe_and_a_name_another_one():
    data = {"algorithm": "PPO", "total_steps": 8, "environment": given()}
    assert merged(**data, recipe=None) == data
    assert merged(**data, recipe="ReachCrowd-v0")["hyperparameters"]["gamma"] == 0.997
    with pytest.raises(ValueError, match=r"unknown recipe 'ReachGaol-v0' \(did you mean 'ReachGoal-v0'\?\); allowed"):
        merged(**data, recipe="ReachGaol-v0")


def test_an_id_of_ones_own_has_the_recipe_of_its_task():
    register("my_lab/House-v0", ENVIRONMENTS["lidarnaut/Explore-v0"][1]["task"], world="turtlebot3_house")
    own = merged(environment={"id": "my_lab/House-v0"})
    assert own["recipe"] == "Explore-v0"
    assert "world" not in own["environment"]
    assert merged(environment={"id": "CartPole-v1"}) == {"environment": {"id": "CartPole-v1"}}


def test_objects_and_runs_are_complete(tmp_path, monkeypatch, caplog, tiny_run):
    seen = []
    monkeypatch.setattr("lidarnaut.agents.learning.run_training", lambda config, **_: seen.append(config) or tmp_path)
    caplog.set_level(logging.INFO, "lidarnaut.agents")
    data = {"environment": given(), "hyperparameters": {"gamma": 0.9}}
    train(data)
    (line,) = caplog.messages
    assert line.startswith("recipe ReachGoal-v0: total_steps 1000000, num_envs 128, algorithm PPO, ")
    assert line.endswith("; changed by you: hyperparameters.gamma")
    train(seen[0])
    train(parse_config({"experiment": "a", "algorithm": "PPO", "total_steps": 8, "environment": given()}, "a"))
    assert seen[1] == seen[0]
    assert (seen[2].num_envs, seen[2].hyperparameters) == (16, {})
    train(resume=tiny_run, trust=["tests"])
    train(tiny_run / "config.yaml", trust=["tests"])
    assert [config.recipe for config in seen] == ["ReachGoal-v0", "ReachGoal-v0", None, None, None]
    assert len(caplog.messages) == 1


def test_a_sweep_keeps_the_recipe_of_its_beginning(tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr("lidarnaut.agents.seeds.train_seeds", lambda data, source, **_: seen.append(data))
    train({"environment": given(), "seeds": [0, 1]})
    assert (seen[0]["recipe"], len(seen[0]["hyperparameters"])) == ("ReachGoal-v0", 7)
    (tmp_path / "sweep.yaml").write_text(yaml.safe_dump(seen[0] | {"hyperparameters": {}}))
    train(resume=tmp_path)
    train(tmp_path / "sweep.yaml")
    assert seen[1] == seen[2] == seen[0] | {"hyperparameters": {}}


def test_mistakes_are_named_before_torch_is_imported(tmp_path):
    (tmp_path / "a.yaml").write_text(yaml.safe_dump({"environment": given(), "total_stesp": 3}))
    code = (
        "import sys; from lidarnaut.train_command import main; code = main(['--config', 'a.yaml', '--seed', '1']); "
        "sys.exit(code if 'torch' not in sys.modules else 9)"
    )
    own = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=own, capture_output=True, text=True)
    assert done.returncode == 2, done.stderr
    assert "unknown key 'total_stesp' (did you mean 'total_steps'?)" in done.stderr
    assert "recipe ReachGoal-v0: " in done.stderr


def test_values_of_a_wrong_type_are_named():
    for wrong in ({"environment": "x"}, {"network": 3}, {"evaluation": {"environment": "x"}}, {"algorithm": 3}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            parse_config(merged(**{"environment": given(), **wrong}), "a")

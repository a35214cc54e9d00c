import inspect
import typing

import gymnasium
import pytest

import lidarnaut
from lidarnaut.agents.config import EnvironmentConfig, TrainingConfig
from lidarnaut.benchmarks.arena.settings import Settings
from lidarnaut.envs.robots import load_robot

pytest.importorskip("torch", reason="learned policies are part of the public API")


def test_dir_lists_the_public_names_alone_and_each_has_a_docstring_and_types():
    with pytest.raises(AttributeError, match=r"no attribute 'fly'.* make_policy, policies_for"):
        lidarnaut.fly  # noqa: B018
    assert dir(lidarnaut) == lidarnaut.__all__
    assert len(lidarnaut.__all__) <= 20
    for name in set(lidarnaut.__all__) - {"__version__"}:
        value = getattr(lidarnaut, name)
        assert inspect.getdoc(value), name
        if inspect.isfunction(value):
            assert set(inspect.signature(value).parameters) | {"return"} == set(typing.get_type_hints(value)), name


def test_a_first_session_works_with_public_names(tmp_path):
    with gymnasium.make("lidarnaut/ReachGoal-v0", physics="kinematic", world="rooms", time_limit=4.0) as env:
        env.reset(seed=0)
        episode = lidarnaut.run_episode(env, lidarnaut.policies_for(env)["pursuit"](), seed=0)
    assert repr(episode).startswith("Episode(end_reason=")
    assert len(repr(episode)) < 500
    assert {"rooms", "turtlebot3_world", "barn:299"} <= set(lidarnaut.worlds())
    assert "turtlebot3_burger" in lidarnaut.robots()


def test_evaluate_takes_names_and_own_policies_and_keeps_files_if_asked(tmp_path):
    common = {"id": "lidarnaut/ReachGoal-v0", "arguments": {"time_limit": 2.0}, "physics": ["kinematic"], "episodes": 2}
    own = {"still": lambda: lidarnaut.make_policy("random"), "pursuit": None}
    summary = lidarnaut.evaluate(["random", "pursuit"], ["rooms"], people=[2], out=tmp_path / "out", **common)
    assert summary["random"]["rooms"]["success"].n == 2
    assert (tmp_path / "out" / "report.html").is_file()
    del own["pursuit"]
    assert set(lidarnaut.evaluate(own, ["rooms"], **common)) == {"still"}
    with pytest.raises(ValueError, match=r"episodes.* 1"):
        lidarnaut.evaluate(["random"], **common | {"episodes": 0})


def test_evaluate_has_the_defaults_of_settings():
    fields, parameters = Settings.model_fields, inspect.signature(lidarnaut.evaluate).parameters
    shared = (fields.keys() & parameters.keys()) - {"policies", "arguments"}
    assert {"worlds", "people", "episodes", "seed", "id"} <= shared
    assert {name: parameters[name].default for name in shared} == {name: fields[name].default for name in shared}


def test_train_keeps_the_objects_of_a_configuration(monkeypatch, tmp_path):
    seen = []
    monkeypatch.setattr("lidarnaut.agents.learning.run_training", lambda config, **_: seen.append(config) or tmp_path)
    robot, crowd = load_robot("jackal"), lidarnaut.Crowd(number=3)
    environment = EnvironmentConfig(id="lidarnaut/ReachGoal-v0", robot=robot, people=crowd)
    config = TrainingConfig(experiment="a", algorithm="PPO", total_steps=64, environment=environment)
    lidarnaut.train(config)
    lidarnaut.train(config, {"environment.world": "rooms"})
    assert seen[0] == config
    assert seen[1].environment.arguments == {"robot": robot, "people": crowd, "world": "rooms"}


def test_train_takes_a_mapping_with_changes_and_refuses_unknown_keys():
    data = {"experiment": "a", "algorithm": "PPO", "total_steps": 64, "environment": {"id": "lidarnaut/ReachGoal-v0"}}
    with pytest.raises(ValueError, match=r"no argument .worlt. .did you mean .world"):
        lidarnaut.train(data, {"environment.worlt": "rooms"})
    with pytest.raises(ValueError, match="did you mean 'reach_crowd'"):
        lidarnaut.train("reach_crwd")
    with pytest.raises(ValueError, match="unknown configuration 'arena'"):
        lidarnaut.train("arena")

import contextlib
import json
import shutil
import sys

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from lidarnaut import evaluate_command as evaluate
from lidarnaut import train_command as train
from lidarnaut.agents import export
from lidarnaut.agents.explorer import LearnedPolicy
from lidarnaut.agents.learned import PRETRAINED
from lidarnaut.agents.trust import REGISTERED, check_names
from lidarnaut.envs.files import load_object
from lidarnaut.envs.ids import find_spec

HOSTILE = """
import pathlib, subprocess
import numpy as np
from lidarnaut.envs.task import Rewards

pathlib.Path(__file__).with_name("imported").touch()


class Own(Rewards):
    pass


SETTINGS = {"a": 1}
"""


@pytest.fixture
def hostile(tmp_path, monkeypatch):
    """Create a module; return a function that returns True if the module was imported."""
    (tmp_path / "hostile_code.py").write_text(HOSTILE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "hostile_code", raising=False)
    yield (tmp_path / "imported").exists
    sys.modules.pop("hostile_code", None)


def policy_folder(folder, change):
    shutil.copytree(PRETRAINED / "reach", folder)
    record = json.loads((folder / "checkpoint.json").read_text())
    change(record["config"])
    (folder / "checkpoint.json").write_text(json.dumps(record))
    return folder


def name_reward(config):
    config["environment"]["reward"] = "hostile_code:Own"


def evaluate_policy(folder, *trust):
    policy = policy_folder(folder / "policy", name_reward)
    words = ["--policies", f"ppo:{policy}", "--episodes", "1", "--out", "out", "--time-limit", "1"]
    words += ["--id", "lidarnaut/ReachGoal-v0", "--worlds", "rooms", "--physics", "kinematic"]
    return evaluate.main([*words, *(["--trust", *trust] if trust else [])])


def export_policy(folder):
    pytest.importorskip("onnx")
    export.export_policy(str(policy_folder(folder / "policy", name_reward)), folder / "a.onnx")


def run_folder(folder, change=name_reward):
    """Return a run folder whose checkpoint names the code, and whose configuration is changed."""
    run = folder / "run"
    saved = policy_folder(run / "checkpoints" / "step_000000010", name_reward)
    shutil.copy(saved / "policy.safetensors", saved / "training.safetensors")
    record = json.loads((saved / "checkpoint.json").read_text())
    record["sha256"]["training.safetensors"] = record["sha256"]["policy.safetensors"]
    (saved / "checkpoint.json").write_text(json.dumps(record))
    config = yaml.safe_load((PRETRAINED / "reach" / "config.yaml").read_text())
    change(config)
    (run / "config.yaml").write_text(yaml.safe_dump(config))
    return run


def sweep(folder):
    config = yaml.safe_load((PRETRAINED / "reach" / "config.yaml").read_text())
    name_reward(config)
    (folder / "sweep.yaml").write_text(yaml.safe_dump({**config, "seeds": [0]}))
    return folder


RECORDS = {
    "policy": lambda folder: LearnedPolicy.load(policy_folder(folder / "policy", name_reward)),
    "policy of an evaluation": evaluate_policy,
    "policy to export": export_policy,
    "run": lambda folder: train.main(["--resume", str(run_folder(folder))]),
    "checkpoint of a run": lambda folder: train.main(["--resume", str(run_folder(folder, lambda config: None))]),
    "configuration of a run": lambda folder: train.main(["--config", str(run_folder(folder) / "config.yaml")]),
    "sweep": lambda folder: train.main(["--resume", str(sweep(folder))]),
}


@pytest.mark.parametrize("name", RECORDS)
def test_no_record_runs_code_that_the_caller_does_not_name(name, hostile, tmp_path, capsys):
    try:
        assert RECORDS[name](tmp_path) == 2
        said = capsys.readouterr().err
    except ValueError as error:
        said = str(error)
    assert not hostile()
    assert "'hostile_code:Own', which is not part of the package" in said
    assert "--trust hostile_code" in said
    assert "trust=['hostile_code']" in said


def test_a_policy_that_names_trusted_code_acts(hostile, tmp_path):
    assert evaluate_policy(tmp_path, "hostile_code") == 0
    assert hostile()
    LearnedPolicy.load(tmp_path / "policy", trust=["hostile_code:Own"])
    LearnedPolicy.load(tmp_path / "policy", trust="hostile_code")


@pytest.mark.parametrize(
    "name",
    ["hostile_code:subprocess.Popen", "hostile_code:pathlib", "hostile_code:np.load", "hostile_code:Rewards",
     "hostile_code:np.random.default_rng", "hostile_code2:Own", "hostile:Own", "os:system", ":", "a:b:c",
     "lidarnaut.envs.files:load_object", "lidarnaut.agents.robots:load_robot", "torch:load", "x=os:system",
     "C:/os:lidarnaut/A-v0", "C:\\os:system",
     "os:system?x=1", "ppo:os.system", "os.path:join\n", "hostile_code.x:lidarnaut/A-v0"],
)  # fmt: skip
def test_trust_in_a_module_covers_what_it_defines(hostile, name):
    trust = ["hostile_code"] if name.startswith("hostile_code:") else ["elsewhere"]
    for record in ({"a": {"b": [name]}}, {"a": {name: None}}, {"a": [[name]]}):
        with pytest.raises(ValueError, match=r"f\.yaml: 'a.*not part of the package"):
            check_names(record, "f.yaml", trust)
    check_names({"a": name}, "f.yaml", [name])
    check_names({"a": ["hostile_code:Own", "hostile_code:SETTINGS"]}, "f.yaml", ["hostile_code"])


@pytest.mark.parametrize("id", ["h:/Own-v0", "h:\\Own-v0"])
def test_a_path_with_a_drive_is_no_id(tmp_path, monkeypatch, id):
    (tmp_path / "h.py").write_text(HOSTILE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ValueError, match="unknown id"):
        find_spec(id)
    assert not (tmp_path / "imported").exists()


@pytest.mark.parametrize("name", sorted(REGISTERED))
def test_registered_names_exist(name):
    check_names({"a": name}, "f.yaml")
    assert load_object(name) is not None


TEXTS = st.text(max_size=12) | st.sampled_from(["a:b", "os:system", "x:y/Z-v0", "rooms", "C:\\a", "torch.nn:ReLU"])
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | TEXTS,
    lambda below: st.lists(below, max_size=3) | st.dictionaries(TEXTS, below, max_size=3),
    max_leaves=8,
)


@given(VALUES)
def test_a_record_that_passes_holds_no_name_that_can_be_imported(record):
    try:
        check_names({"record": record}, "f.yaml")
    except ValueError:
        return

    def walk(value):
        if isinstance(value, dict):
            value = [*value, *value.values()]
        if isinstance(value, list):
            for one in value:
                walk(one)
        elif isinstance(value, str) and value not in REGISTERED:
            module, _, attribute = value.partition(":")
            assert not (attribute and module.isidentifier() and attribute.isidentifier())

    walk(record)


KEYS = ["environment", "hyperparameters", "network", "evaluation", "algorithm", "policy_kwargs", "observations", "id",
        "robots", "world", "slam", "localizer", "sensors", "task",
        "features_extractor_class", "references"]  # fmt: skip


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.sampled_from(KEYS), min_size=1, max_size=4), st.booleans(), st.booleans())
def test_no_key_of_a_policy_record_imports(hostile, tmp_path, keys, in_list, is_key):
    def change(config):
        *parents, last = keys
        for key in parents:
            below = config.get(key)
            config[key] = config = below if isinstance(below, dict) else {}
        name = "hostile_code:Own"
        config[last] = {name: None} if is_key else [name] if in_list else name

    shutil.rmtree(tmp_path / "policy", ignore_errors=True)
    with contextlib.suppress(Exception):
        LearnedPolicy.load(policy_folder(tmp_path / "policy", change))
    assert not hostile()

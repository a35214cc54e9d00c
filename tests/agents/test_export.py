import json
import sys

import numpy as np
import pytest
import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import CombinedExtractor

from lidarnaut.agents.checkpoint import POLICY_FILE
from lidarnaut.agents.completion.completion import Completion
from lidarnaut.agents.completion.network import CompletionNetwork
from lidarnaut.agents.evaluation import evaluation_environment
from lidarnaut.agents.explorer import LearnedPolicy
from lidarnaut.agents.export import export_policy as main
from lidarnaut.agents.learned import PRETRAINED, find_policy
from lidarnaut.agents.run_folder import CheckpointError
from lidarnaut.agents.training import train
from lidarnaut.agents.vec_env import make_env
from lidarnaut.envs.core import lidar_env_of
from lidarnaut.envs.robots import load_robot
from tests.agents.tiny import CASES, tiny

NO_REFERENCES = {"episodes": 1, "every": 1000, "references": []}
DIFFERENT = ("SAC", "TD3", "TQC", "CrossQ", "RecurrentPPO", "MaskablePPO", "DQN", "QRDQN")
"""Algorithms whose networks differ."""
EXPORTED = [("PPO", "ExploreFrontiers"), *(case for case in CASES if case[0] in DIFFERENT)]
NETWORKS = sorted(path.parent.name for path in PRETRAINED.glob(f"*/{POLICY_FILE}"))


@pytest.fixture
def onnxruntime():
    pytest.importorskip("onnx", reason="onnx is not installed")
    return pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")


class Quadrant:
    """One-hot quadrant of the robot's heading."""

    def space(self, robot):
        return spaces.MultiBinary(4)

    def write(self, robot, out):
        out[:] = np.arange(4) == int(robot.belief.pose.theta // (0.5 * np.pi)) % 4


class Fickle(CombinedExtractor):
    """Feature extractor with a Python branch, which ONNX cannot store."""

    def forward(self, observations):
        sign = 1.0 if observations["motion"].sum() > 0 else -1.0
        return sign * super().forward(observations)


def read(onnxruntime, path):
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(path, options)
    return session, json.loads(session.get_modelmeta().custom_metadata_map["lidarnaut"])


def acts_alike(onnxruntime, config, run, path, steps=12):
    """Compare the actions of the ONNX file with the torch policy; return the metadata."""
    session, about = read(onnxruntime, path)
    policy = LearnedPolicy.load(run, trust="tests")
    env = make_env(evaluation_environment(config), "test")
    inner = lidar_env_of(env)
    policy.reset(inner.robot_params, inner.control_period, np.random.default_rng(0))
    observation, _ = env.reset(seed=7)
    state = {name: np.zeros(shape, np.float32) for name, shape in about["states"].items()}
    assert {one.name for one in session.get_inputs()} == observation.keys() | state.keys()
    for _ in range(steps):
        batch = {name: np.asarray(part)[None] for name, part in observation.items()}
        action, *following = session.run(None, {**batch, **state})
        state = dict(zip(state, following))
        wanted = policy(observation)
        assert action.shape == (1, *wanted.shape)
        np.testing.assert_allclose(action[0], wanted, rtol=0, atol=1e-5 if action.dtype.kind == "f" else 0)
        assert env.action_space.contains(np.asarray(action[0], env.action_space.dtype)[()])
        observation, _, terminated, truncated, _ = env.step(wanted)
        if terminated or truncated:
            break
    env.close()
    return about


@pytest.mark.parametrize(("algorithm", "id"), EXPORTED)
def test_a_file_acts_as_the_policy_of_every_algorithm(algorithm, id, trained, onnxruntime, tmp_path):
    config, run = trained(algorithm, id)
    returned = main(f"learned:{run}", tmp_path / "new" / "policy.onnx")
    about = acts_alike(onnxruntime, config, run, tmp_path / "new" / "policy.onnx")
    assert about == json.loads(json.dumps(returned))
    assert (about["algorithm"], about["environment"]["id"]) == (algorithm, f"lidarnaut/{id}-v0")
    kind, shape, high = ("Discrete", [], 47) if "Frontiers" in id else ("Box", [2], 1.0)
    assert about["action"].items() >= {"kind": kind, "shape": shape, "high": high}.items()
    assert list(about["states"]) == (["state_h", "state_c"] if algorithm == "RecurrentPPO" else [])


def test_parts_of_any_name_and_kind_and_networks_of_the_library(onnxruntime, tmp_path):
    environment = {"id": "lidarnaut/ReachCrowd-v0", "world": "hall", "world_size": [8, 8], "num_workers": 0}
    environment["robots"] = [f"lidarnaut.agents.robots:{name}" for name in ("SEES_AROUND", "SLOW_SEES_AROUND")]
    environment["time_limit"] = 1.0
    parts = {"scan_history": None, "goal": None, "limits": None, "quadrant": "tests.agents.test_export:Quadrant"}
    extractor = "stable_baselines3.common.torch_layers:CombinedExtractor"
    plain = {"features_extractor_class": extractor, "features_extractor_kwargs": {}, "net_arch": [16, 8]}
    hyperparameters = {"n_steps": 4, "batch_size": 8, "policy_kwargs": plain}
    config = tiny(
        "PPO", "Explore", environment=environment | {"observations": parts}, evaluation=NO_REFERENCES,
        hyperparameters=hyperparameters, network={},
    )  # fmt: skip
    run = train(config, run=tmp_path / "run", progress=False)
    main(str(run), tmp_path / "policy.onnx", trust=("tests",))
    about = acts_alike(onnxruntime, config, run, tmp_path / "policy.onnx")
    assert about["inputs"].keys() == parts.keys()
    assert about["inputs"]["quadrant"] == {
        **{"kind": "MultiBinary", "shape": [4], "dtype": "int8", "low": 0.0, "high": 1.0},
        "about": "One-hot quadrant of the robot's heading.",
    }
    assert about["robot"]["name"] == "sees_around"


@pytest.mark.parametrize("name", NETWORKS)
def test_every_network_of_the_package_becomes_a_file(name, onnxruntime, tmp_path):
    about = main(f"ppo:pretrained/{name}", tmp_path / "policy.onnx")  # compares both, on batches of 64 and of 1
    session, _ = read(onnxruntime, tmp_path / "policy.onnx")
    assert {one.name for one in session.get_inputs()} == about["inputs"].keys()


def test_the_network_of_an_explorer_that_completes_maps_becomes_a_file_for_maps_of_any_size(onnxruntime, tmp_path):
    torch.manual_seed(0)
    completion = Completion(CompletionNetwork())
    completion.save(tmp_path / "policy", {})
    about = main(tmp_path / "policy", tmp_path / "completion.onnx")
    session, read_back = read(onnxruntime, tmp_path / "completion.onnx")
    assert read_back == about
    assert about["cell"] == 0.2
    codes = np.random.default_rng(1).integers(0, 4, (2, 48, 112), dtype=np.uint8)
    channels = np.stack([codes & 1 > 0, codes & 2 > 0, codes == 0], axis=1).astype(np.float32)
    (found,) = session.run(None, {"channels": channels})
    np.testing.assert_allclose(found, np.stack([completion.probabilities(one) for one in codes]), atol=1e-5)


def test_the_metadata_are_enough_to_drive(onnxruntime, tmp_path):
    main("ppo:pretrained/twist", tmp_path / "twist.onnx")
    session, about = read(onnxruntime, tmp_path / "twist.onnx")
    robot = load_robot("turtlebot3_burger")
    for name in ("max_v", "max_w", "max_acc_v", "radius"):
        assert about["robot"][name] == getattr(robot, name)
    assert about["robot"]["lidar"]["num_beams"] == robot.lidar.num_beams
    assert about["control_period"] == 0.2
    assert about["inputs"]["limits"].items() >= {"shape": [5], "dtype": "float32", "low": 0.0, "high": 1.0}.items()
    assert "footprint radius / 0.5 m" in about["inputs"]["limits"]["about"]
    assert "yaw rate over robot.max_w" in about["action"]["about"]
    assert (about["policy"], about["steps"]) == ("ppo:pretrained/twist", 401_408)
    assert {"torch", "onnx", "lidarnaut"} <= about["versions"].keys()
    zeros = {name: np.zeros((5, *space["shape"]), space["dtype"]) for name, space in about["inputs"].items()}
    np.testing.assert_array_equal(*(session.run(["action"], zeros)[0][i] for i in (0, 4)))


def test_a_file_that_would_act_otherwise_is_not_written(onnxruntime, tmp_path):
    network = {"features_extractor_class": "tests.agents.test_export:Fickle", "features_extractor_kwargs": {}}
    hyperparameters = {"n_steps": 4, "batch_size": 8, "policy_kwargs": network}
    config = tiny("PPO", "Explore", hyperparameters=hyperparameters, evaluation=NO_REFERENCES)
    run = train(config, run=tmp_path / "run", progress=False)
    message = r"cannot be written as ONNX: actions differ from the policy: action\[\d\] is .*, not .*, in step \d+"
    with pytest.raises(ValueError, match=message):
        main(str(run), tmp_path / "policy.onnx", trust=("tests",))
    assert not (tmp_path / "policy.onnx").exists()


def test_what_is_no_network_is_refused(onnxruntime, tmp_path):
    with pytest.raises(CheckpointError, match=r"frontiers is a frontier score, .* only networks are exported"):
        main("learned:pretrained/frontiers", tmp_path / "policy.onnx")
    with pytest.raises(CheckpointError, match="unknown policy pretrained/none"):
        main("ppo:pretrained/none", tmp_path / "policy.onnx")
    network = {"width": 8, "heads": 2, "prior_policy": "pretrained/frontiers"}
    config = tiny("PPO", "ExploreFrontiersAbstract", network=network, evaluation=NO_REFERENCES)
    run = train(config, run=tmp_path / "run", progress=False)
    with pytest.raises(ValueError, match="its prior is a frontier score, which is not computed by torch"):
        main(str(run), tmp_path / "policy.onnx", trust=("tests",))


@pytest.mark.parametrize("missing", ["onnx", "onnxruntime"])
def test_what_is_not_installed_is_named_with_the_command(missing, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(ImportError, match=r"needs onnx and onnxruntime: pip install 'lidarnaut\[export\]'"):
        main(str(find_policy("pretrained/twist")), tmp_path / "policy.onnx")

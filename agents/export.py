"""Export of policies to ONNX: `python -m lidarnaut.agents.export POLICY OUT.onnx`.

POLICY is a run folder, a checkpoint, or a name such as `ppo:pretrained/twist`. The file has one input per observation,
shape (batch, ...), and the output `action`: the most likely action, clipped to the action space. Recurrent policies add
inputs `state_h` and `state_c` (zeros at the start of an episode) and outputs `next_state_h` and `next_state_c`. The
metadata key `lidarnaut` describes inputs, action, robot and environment as JSON. Of an explorer that completes maps,
the file holds the network: input `channels` (see `lidarnaut.agents.completion.network.channels_of`), output
`probability`.
"""

import contextlib
import dataclasses
import inspect
import io
import json
import sys
import warnings
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
import tyro
from gymnasium import spaces
from stable_baselines3.common.policies import BasePolicy
from torch import Tensor, nn

from lidarnaut.agents.algorithms import Actor, build_policy
from lidarnaut.agents.checkpoint import Record, SpaceRecord, load_checkpoint
from lidarnaut.agents.completion.completion import Completion
from lidarnaut.agents.completion.network import channels_of
from lidarnaut.agents.completion.raster import CELL, STRIDE
from lidarnaut.agents.evaluation import evaluation_environment
from lidarnaut.agents.frontiers.score import RECORD_FILE
from lidarnaut.agents.learned import find_policy, fingerprint, is_completion
from lidarnaut.agents.run_folder import LIBRARIES, CheckpointError
from lidarnaut.agents.vec_env import Observations, make_env
from lidarnaut.baselines.episode import run
from lidarnaut.baselines.policy import marked
from lidarnaut.envs.command_line import run_command
from lidarnaut.envs.core import lidar_env_of
from lidarnaut.envs.files import printable, write_file

TOLERANCE = 1e-5
"""Maximum difference between continuous actions of policy and ONNX file. Discrete actions must be equal."""
NUM_RANDOM, NUM_STEPS = 64, 100
"""Number of random observations, and number of episode steps, to compare policy and ONNX file."""
MEANING = {
    "Box": "(forward speed over robot.max_v, yaw rate over robot.max_w, counter-clockwise), of each robot of a team",
    "Discrete": "row of the candidate to drive to",
}
"""Descriptions of actions in the metadata of the ONNX file, by kind of action space."""


def main(
    policy: Annotated[str, tyro.conf.Positional],
    out: Annotated[Path, tyro.conf.Positional],
    trust: tuple[str, ...] = (),
) -> None:
    """Write a policy as ONNX.

    Args:
        policy: folder of a run, a checkpoint or a policy, with or without the prefix `ppo:` or `learned:`.
        out: file to write.
        trust: modules, or names `module:attribute`, of your own code that the policy may import.
    """
    about = export_policy(policy, out, trust)
    inputs = ", ".join([*about["inputs"], *about.get("states", ())])
    sys.stdout.write(f"{printable(out)}: inputs {inputs}; policy and file give the same outputs\n")


def export_policy(policy: str | Path, out: str | Path, trust: Iterable[str] = ()) -> dict[str, Any]:
    """Write a policy as ONNX and return the metadata of the file. Arguments are those of `main`.

    Raises:
        ImportError: if onnx or onnxruntime is missing.
        CheckpointError: if the policy is missing, damaged or not a network.
        ValueError: if ONNX cannot represent the policy or actions differ.
    """
    try:
        import onnx
        import onnxruntime
    except ImportError as error:
        extra = "pip install 'lidarnaut[export]', or -e '.[export]' in a checkout"
        raise ImportError(f"writing ONNX needs onnx and onnxruntime: {extra}") from error
    folder, out = find_policy(policy), Path(out)
    if (folder / RECORD_FILE).exists():
        if not is_completion(folder):
            raise CheckpointError(f"{folder} is a frontier score, which needs no torch; only networks are exported")
        return _export_completion(str(policy), folder, out)
    checkpoint = load_checkpoint(folder, policy_only=True, trust=trust)
    network, record = build_policy(checkpoint, folder), checkpoint.record
    shape = getattr(network, "lstm_hidden_state_shape", None)
    states = {"state_h": shape, "state_c": shape} if shape else {}
    with contextlib.closing(make_env(evaluation_environment(record.config), "test")) as env:
        inner: Any = lidar_env_of(env)
        about = {"policy": marked(str(policy), None, env), "sha256": fingerprint(folder), **_describe(record, inner)}
        about["states"] = states
        try:
            model = onnx.load_model_from_string(_trace(network, record, states))
            onnx.helper.set_model_props(model, {"lidarnaut": json.dumps(about, indent=1)})
            content = model.SerializeToString()
            options = onnxruntime.SessionOptions()
            options.intra_op_num_threads = 1  # faster for small networks
            _compare(onnxruntime.InferenceSession(content, options), network, env, states)
        except Exception as error:
            raise ValueError(f"{folder} cannot be written as ONNX: {error}") from error
    out.parent.mkdir(parents=True, exist_ok=True)
    write_file(out, content)
    return about


def _export_completion(policy: str, folder: Path, out: Path) -> dict[str, Any]:
    import onnx
    import onnxruntime

    completion = Completion.load(folder)
    graph, example = nn.Sequential(completion.network, nn.Sigmoid()), [torch.zeros(1, 3, 64, 96)]
    axes = {"channels": {0: "batch", 2: "height", 3: "width"}, "probability": {0: "batch", 1: "height", 2: "width"}}
    model = onnx.load_model_from_string(_write(graph, example, ["channels"], ["probability"], axes))
    about = {
        "policy": policy,
        "sha256": fingerprint(folder),
        "inputs": {"channels": {"shape": [3, f"multiple of {STRIDE}", f"multiple of {STRIDE}"], "dtype": "float32"}},
        "about": "input: whether cells hold free, occupied or no known map cells, 0 or 1; output: probability of floor",
        "cell": CELL,
        "versions": {name: version(name) for name in ("lidarnaut", "torch", "onnx")},
    }
    onnx.helper.set_model_props(model, {"lidarnaut": json.dumps(about, indent=1)})
    session = onnxruntime.InferenceSession(model.SerializeToString())
    for shape in ((96, 64), (STRIDE, 5 * STRIDE)):
        codes = np.random.default_rng(0).integers(0, 4, shape, dtype=np.uint8)
        (found,) = session.run(None, {"channels": channels_of(codes[None]).numpy()})
        if found.shape[1:] != shape or np.abs(found[0] - completion.probabilities(codes)).max() > TOLERANCE:
            raise ValueError(f"{folder} cannot be written as ONNX: probabilities differ on a map of {shape} cells")
    out.parent.mkdir(parents=True, exist_ok=True)
    write_file(out, model.SerializeToString())
    return about


class _Graph(nn.Module):
    def __init__(self, policy: BasePolicy, names: list[str]) -> None:
        super().__init__()
        self.policy, self.names = policy, names
        self.has_masks = "action_masks" in inspect.signature(policy.predict).parameters and "action_mask" in names

    def forward(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        space, state = self.policy.action_space, inputs[len(self.names) :]
        # Few ONNX operators accept small integers.
        values = (value.float() if value.dtype in (torch.int8, torch.uint8) else value for value in inputs)
        seen: Any = dict(zip(self.names, values))
        arguments = {"action_masks": seen["action_mask"]} if self.has_masks else {}
        if state:
            arguments |= {"lstm_states": state, "episode_starts": torch.zeros(state[0].shape[1])}
        if isinstance(self.policy.observation_space, spaces.Box):
            seen = torch.cat([seen[name].reshape(seen[name].shape[0], -1).float() for name in sorted(seen)], dim=1)
        found: Any = self.policy._predict(seen, deterministic=True, **arguments)
        action, state = found if state else (found, ())
        action = action.reshape(-1, *(space.shape or ()))
        if isinstance(space, spaces.Box):
            low, high = torch.from_numpy(space.low), torch.from_numpy(space.high)
            action = low + 0.5 * (action + 1.0) * (high - low) if self.policy.squash_output else action
            action = torch.minimum(torch.maximum(action, low), high)
        return action, *state


def _trace(policy: BasePolicy, record: Record, states: dict[str, Any]) -> bytes:
    example, axes = [], {"action": {0: "batch"}}
    for name, described in record.observation.items():
        # All actions allowed: networks may skip unused slots.
        value = np.ones(described.shape, np.int8) if described.kind == "MultiBinary" else described.space().sample()
        example.append(torch.as_tensor(np.stack([value, value])))
        axes[name] = {0: "batch"}
    for name, shape in states.items():
        example.append(torch.zeros(shape).repeat(1, 2, 1))
        axes[name] = axes[f"next_{name}"] = {1: "batch"}
    inputs, outputs = [*record.observation, *states], ["action", *(f"next_{name}" for name in states)]
    return _write(_Graph(policy, [*record.observation]), example, inputs, outputs, axes)


def _write(graph: nn.Module, example: list[Tensor], inputs: list[str], outputs: list[str], axes: Any) -> bytes:
    options: Any = {"input_names": inputs, "output_names": outputs, "dynamic_axes": axes, "opset_version": 17}
    out = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of tracing; see `_compare`
        # The older exporter supports data-dependent shapes.
        torch.onnx.export(graph.eval(), (*example,), out, dynamo=False, **options)  # type: ignore[arg-type]
    return out.getvalue()


def _compare(session: Any, policy: BasePolicy, env: Any, states: dict[str, Any]) -> None:
    env.observation_space.seed(0)
    samples = [env.observation_space.sample() for _ in range(NUM_RANDOM)]
    random = {name: np.stack([one[name] for one in samples]) for name in samples[0]}
    for where, batches in ("random observations", [random] * 3), ("an episode", _episode(policy, env)):
        actor, size = Actor(policy), len(next(iter(batches[0].values())))
        state = {name: np.zeros((layers, size, width), np.float32) for name, (layers, _, width) in states.items()}
        for step, batch in enumerate(batches):
            wanted = actor(batch, np.full(size, step == 0))
            found, *following = session.run(None, {**batch, **state})
            state = dict(zip(states, following))
            wrong = np.abs(wanted - found) > (TOLERANCE if found.dtype.kind == "f" else 0)
            if found.shape != wanted.shape or wrong.any():
                at = tuple(np.argwhere(wrong)[0].tolist()) if wrong.any() else ()
                what = f"action{[*at[1:]] or ''} is {found[at]}, not {wanted[at]}" if at else f"shape {found.shape}"
                raise ValueError(f"actions differ from the policy: {what}, in step {step} of {where}")


def _episode(policy: BasePolicy, env: Any) -> list[Observations]:
    actor, batches = Actor(policy), list[Observations]()

    def decide(observation: Observations) -> np.ndarray:
        batches.append({name: np.asarray(value)[None] for name, value in observation.items()})
        return actor(batches[-1], np.array([len(batches) == 1]))[0]

    run(env, decide, *env.reset(seed=0), max_steps=NUM_STEPS)
    return batches


def _describe(record: Record, env: Any) -> dict[str, Any]:
    config, parts = record.config, getattr(env, "parts", {})
    inputs = {name: _describe_space(space) for name, space in record.observation.items()}
    for name in inputs.keys() & parts.keys():
        inputs[name]["about"] = inspect.getdoc(type(parts[name]))
    arguments = config.environment.arguments | config.evaluation.arguments
    return {
        "algorithm": config.algorithm,
        "steps": record.steps,
        "environment": {"id": config.environment.id, "arguments": arguments, "about": inspect.getdoc(type(env))},
        "control_period": env.control_period,
        "inputs": inputs,
        "action": _describe_space(record.action) | {"about": MEANING[record.action.kind]},
        "robot": dataclasses.asdict(env.robot_params),
        "versions": {name: version(name) for name in ("lidarnaut", *LIBRARIES, "onnx")},
    }


def _describe_space(space: SpaceRecord) -> dict[str, Any]:
    single = {"shape": (), "high": space.shape[0] - 1} if space.kind == "Discrete" else {}
    return json.loads(space.model_copy(update=single).model_dump_json())


if __name__ == "__main__":
    run_command(main)

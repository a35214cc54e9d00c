"""Drive a robot with an ONNX policy, using only onnxruntime and NumPy.

`python -m lidarnaut.agents.export ppo:pretrained/twist runs/twist.onnx` writes the file; if missing, this script runs
the command in a process of its own, because it needs torch. The file's metadata describe all inputs.
"""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import onnxruntime
import tyro

import lidarnaut  # noqa: F401  (registers the environments)


class OnnxPolicy:
    """Policy that returns the most likely action; `about` describes its inputs and actions."""

    def __init__(self, path: Path) -> None:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1  # small networks are slower on more threads
        self._session = onnxruntime.InferenceSession(path, options)
        self.about: dict[str, Any] = json.loads(self._session.get_modelmeta().custom_metadata_map["lidarnaut"])
        self.reset()

    def reset(self, *_: Any) -> None:
        """Clear the recurrent state at the start of an episode."""
        self._state = {name: np.zeros(shape, np.float32) for name, shape in self.about["states"].items()}

    def __call__(self, observation: dict[str, np.ndarray]) -> np.ndarray:
        """Return the action for an observation."""
        batch = {name: np.asarray(observation[name])[None] for name in self.about["inputs"]}
        action, *state = self._session.run(None, {**batch, **self._state})
        self._state = dict(zip(self._state, state))
        return action[0]


def main(path: Path = Path("runs/twist.onnx"), seconds: float = 60.0) -> dict[str, Any]:
    """Drive in the policy's evaluation environment and return the last `info`."""
    if not path.exists():
        subprocess.run([sys.executable, "-m", "lidarnaut.agents.export", "ppo:pretrained/twist", path], check=True)
    policy = OnnxPolicy(path)
    environment, robot = policy.about["environment"], policy.about["robot"]
    env = gymnasium.make(environment["id"], **{"split": "test", **environment["arguments"]})
    observation, info = env.reset(seed=0)
    is_over = False
    while not is_over and info["time"] < seconds:
        action = policy(observation)
        observation, _, terminated, truncated, info = env.step(action)
        is_over = terminated or truncated
    env.close()
    v, w = action * [robot["max_v"], robot["max_w"]]
    print(f"{robot['name']}: {info['path_length']:.1f} m in {info['time']:.0f} s, last at {v:.2f} m/s, {w:.2f} rad/s")
    return info


if __name__ == "__main__":
    tyro.cli(main)

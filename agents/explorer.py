"""A trained policy that explores."""

import warnings
from pathlib import Path

import numpy as np
import torch
from stable_baselines3.common.policies import ActorCriticPolicy

from agents.checkpoint import Record, load_checkpoint
from agents.ppo import build_policy, mean_action
from agents.run_folder import CheckpointError, find_checkpoint
from envs.robots import RobotParams


class PPOExplorer:
    """Drives as a policy trained with `train.py` would. Looks at observations only."""

    end_reason = plan = None
    """A policy never stops by itself, and plans no path."""

    def __init__(self, policy: ActorCriticPolicy, record: Record, name: str, *, deterministic: bool = True) -> None:
        """Take a trained policy, with the record and the name of its checkpoint, for messages; see `load`."""
        self._policy, self._record, self._name = policy, record, name
        self._deterministic = deterministic
        self._std = policy.log_std.detach().exp().numpy()

    @classmethod
    def load(cls, path: str | Path, *, deterministic: bool = True) -> "PPOExplorer":
        """Load a policy.

        Sets torch to one thread: passes this small are slower on more.

        Args:
            path: run folder (its newest checkpoint is taken) or checkpoint folder.
            deterministic: whether to take the mean action, or to draw one as in training.

        Raises:
            CheckpointError: if there is no checkpoint, or it is damaged.
        """
        torch.set_num_threads(1)
        folder = find_checkpoint(path)
        checkpoint = load_checkpoint(folder)
        return cls(build_policy(checkpoint, folder), checkpoint.record, str(folder), deterministic=deterministic)

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        """Prepare for an episode.

        A policy decides as often as it did in training. Where it is asked more often, it repeats its decision.

        Raises:
            CheckpointError: if the robot's lidar has another number of beams than the policy was trained with.
        """
        trained = self._record.observation["scan"].shape[0]
        if robot.lidar.num_beams != trained:
            raise CheckpointError(
                f"{self._name} needs scans of {trained} beams, but the lidar of robot {robot.name!r} has "
                f"{robot.lidar.num_beams}; take a robot with the lidar of its training "
                f"({self._record.config.environment.robot or 'turtlebot3_burger'})"
            )
        trained_period = 1.0 / self._record.config.environment.control_hz
        self._repeats = max(1, round(trained_period / control_period))
        if abs(self._repeats * control_period - trained_period) > 0.01 * trained_period:
            warnings.warn(
                f"{self._name} was trained to decide every {trained_period:.3g} s, and is asked every "
                f"{control_period:.3g} s: it will decide every {self._repeats * control_period:.3g} s",
                stacklevel=2,
            )
        self._rng = rng
        self._calls = 0
        self._action = np.zeros(self._record.action.shape, dtype=np.float32)

    def __call__(self, observation: dict[str, np.ndarray]) -> np.ndarray:
        """Return the action, shape (2,), float32.

        Raises:
            CheckpointError: if the observation is not the one that the policy was trained on.
        """
        if self._calls % self._repeats == 0:
            self._action = self._decide(observation)
        self._calls += 1
        return self._action.copy()

    def _decide(self, observation: dict[str, np.ndarray]) -> np.ndarray:
        needed = self._record.observation
        given = {key: (value.shape, str(value.dtype)) for key, value in observation.items()}
        if given != {key: (box.shape, box.dtype) for key, box in needed.items()}:
            boxes = ", ".join(f"{key} {box}" for key, box in needed.items())
            raise CheckpointError(f"{self._name} needs observations {boxes}; it was given {given}")
        action = mean_action(self._policy, {key: value[None] for key, value in observation.items()})[0]
        if not self._deterministic:
            action = action + self._std * self._rng.standard_normal(action.shape)
        return np.clip(action, -1.0, 1.0).astype(np.float32)

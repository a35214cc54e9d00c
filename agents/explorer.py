"""Trained policies that explore: by twists, or by choosing frontiers."""

import math
import warnings
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import torch
from stable_baselines3.common.policies import ActorCriticPolicy

from agents.checkpoint import BoxRecord, DiscreteRecord, Record, load_checkpoint
from agents.policies import Level
from agents.ppo import build_policy, mean_action
from agents.run_folder import CheckpointError, find_checkpoint
from envs.robots import RobotParams, load_robot


class _TrainedPolicy:
    """A policy trained with `train.py`. Looks at observations only."""

    level: Level
    """What it decides; see `agents.policies.Level`."""
    end_reason = plan = None
    """A policy never stops by itself, and plans no path."""
    _actions: ClassVar[type[BoxRecord] | type[DiscreteRecord]]

    def __init__(self, policy: ActorCriticPolicy, record: Record, name: str, *, deterministic: bool = True) -> None:
        """Take a trained policy, with the record and the name of its checkpoint, for messages; see `load`.

        Raises:
            CheckpointError: if it decides something else.
        """
        if not isinstance(record.action, self._actions):
            raise CheckpointError(f"{name} has actions {record.action}, which {type(self).__name__} does not take")
        self._policy, self._record, self._name = policy, record, name
        self._deterministic = deterministic
        self.observations = record.config.environment.observations
        """Parts of the observation that it needs, by name; None for the environment's own."""
        self._needed = {
            key: (space.shape, str(space.dtype))
            for key, space in ((key, described.space()) for key, described in record.observation.items())
        }

    @classmethod
    def load(cls, path: str | Path, *, deterministic: bool = True) -> Self:
        """Load a policy.

        Sets torch to one thread: passes this small are slower on more.

        Args:
            path: run folder (its newest checkpoint is taken) or checkpoint folder.
            deterministic: whether to take the most likely action, or to draw one as in training.

        Raises:
            CheckpointError: if there is no checkpoint, it is damaged, or holds another kind of policy.
        """
        return cls(*_load(path), deterministic=deterministic)

    def _batch(self, observation: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return an observation as a batch of one.

        Raises:
            CheckpointError: if it is not the one that the policy was trained on.
        """
        given = {key: (value.shape, str(value.dtype)) for key, value in observation.items()}
        if given != self._needed:
            needed = ", ".join(f"{key} {space}" for key, space in self._record.observation.items())
            raise CheckpointError(f"{self._name} needs observations {needed}; it was given {given}")
        return {key: value[None] for key, value in observation.items()}


class PPOExplorer(_TrainedPolicy):
    """Drives as a policy of twists would."""

    level = "twist"
    _actions = BoxRecord

    def __init__(self, policy: ActorCriticPolicy, record: Record, name: str, *, deterministic: bool = True) -> None:
        super().__init__(policy, record, name, deterministic=deterministic)
        self._std = policy.log_std.detach().exp().numpy()

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        """Prepare for an episode.

        A policy decides as often as it did in training. Where it is asked more often, it repeats its decision. A scan
        with another number of beams is shown to it as that of the lidar of its training.

        Raises:
            CheckpointError: if the robot's lidar has another number of beams, and that of the training is not known.
        """
        scan = self._record.observation["scan"]
        assert isinstance(scan, BoxRecord)
        trained, self._beams = self._record.config.environment.robot, None
        if robot.lidar.num_beams != scan.shape[0]:
            if trained is None:
                raise CheckpointError(
                    f"{self._name} needs scans of {scan.shape[0]} beams, but the lidar of robot {robot.name!r} has "
                    f"{robot.lidar.num_beams}; take a robot with the lidar of its training, or name the robot there "
                    "(environment.robot)"
                )
            lidar = load_robot(trained).lidar
            match = lidar.directions.T @ robot.lidar.directions
            in_view = match.max(axis=1) >= math.cos(1.5 * robot.lidar.angle_increment)
            self._beams = match.argmax(axis=1), in_view, robot.lidar.range_max / lidar.range_max
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
        self._action = np.zeros(self._std.shape, dtype=np.float32)

    def __call__(self, observation: dict[str, np.ndarray]) -> np.ndarray:
        """Return the action, shape (2,), float32.

        Raises:
            CheckpointError: if the observation is not the one that the policy was trained on.
        """
        if self._calls % self._repeats == 0:
            if self._beams is not None:
                nearest, in_view, scale = self._beams
                scan = observation["scan"][nearest]
                scan = np.where(scan < 1.0, np.minimum(scan * np.float32(scale), np.float32(1.0)), scan)
                observation = {**observation, "scan": np.where(in_view, scan, np.float32(0.0))}
            self._action = self._decide(observation)
        self._calls += 1
        return self._action.copy()

    def _decide(self, observation: dict[str, np.ndarray]) -> np.ndarray:
        action = mean_action(self._policy, self._batch(observation))[0]
        if not self._deterministic:
            action = action + self._std * self._rng.standard_normal(action.shape)
        return np.clip(action, -1.0, 1.0).astype(np.float32)


class PPOChooser(_TrainedPolicy):
    """Chooses frontiers as a policy of decisions would."""

    level = "decision"
    _actions = DiscreteRecord

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        """Prepare for an episode: nothing is remembered. Robots, and the time between decisions, may be any."""
        self._rng = rng

    def __call__(self, observation: dict[str, np.ndarray]) -> np.int64:
        """Return the candidate to go to.

        Raises:
            CheckpointError: if the observation is not the one that the policy was trained on.
        """
        batch = self._batch(observation)
        if self._deterministic:
            return np.int64(mean_action(self._policy, batch)[0])
        with torch.no_grad():
            tensors = {key: torch.as_tensor(value) for key, value in batch.items()}
            distribution: Any = self._policy.get_distribution(tensors).distribution
        shares = distribution.probs[0].numpy().astype(np.float64)
        return np.int64(self._rng.choice(len(shares), p=shares / shares.sum()))


def load_trained(path: str | Path) -> PPOExplorer | PPOChooser:
    """Load a policy of either kind, which takes its most likely actions; as `PPOExplorer.load`."""
    policy, record, name = _load(path)
    make = PPOChooser if isinstance(record.action, DiscreteRecord) else PPOExplorer
    return make(policy, record, name)


def _load(path: str | Path) -> tuple[ActorCriticPolicy, Record, str]:
    torch.set_num_threads(1)
    folder = find_checkpoint(path)
    checkpoint = load_checkpoint(folder, policy_only=True)
    return build_policy(checkpoint, folder), checkpoint.record, str(folder)

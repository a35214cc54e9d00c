"""Loading and inference of policies trained with `train.py`."""

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Self

import numpy as np
import torch
from stable_baselines3.common.policies import BasePolicy

from lidarnaut.agents.algorithms import Actor, build_policy
from lidarnaut.agents.checkpoint import Record, load_checkpoint
from lidarnaut.agents.inference import one_thread
from lidarnaut.agents.run_folder import CheckpointError, find_checkpoint
from lidarnaut.baselines.policy import ObservationPolicy
from lidarnaut.envs.robots import RobotParams, load_robot


class LearnedPolicy(ObservationPolicy):
    """Trained network that returns actions for observations."""

    def __init__(self, policy: BasePolicy, record: Record, name: str, *, deterministic: bool = True) -> None:
        self._actor = Actor(policy, deterministic=deterministic)
        self._record, self._name, self._deterministic = record, name, deterministic
        self.level = "decision" if record.action.kind == "Discrete" else "twist"
        self.id = record.config.environment.id
        self.arguments = record.config.environment.arguments | record.config.evaluation.arguments
        self.observations = self.arguments.get("observations")
        """Names of required observations; None for the environment's default."""
        self.collision_monitor = bool(self.arguments.get("collision_monitor"))
        """Whether the policy drives with the collision monitor, which slows down before obstacles."""
        self.control_hz = record.control_hz
        self._is_first = True
        self._beams: tuple[np.ndarray, np.ndarray, float] | None = None
        spaces = {key: described.space() for key, described in record.observation.items()}
        self._needed = {key: (space.shape, str(space.dtype)) for key, space in spaces.items()}

    @classmethod
    def load(cls, path: str | Path, *, deterministic: bool = True, trust: Iterable[str] = ()) -> Self:
        """Load a policy.

        Args:
            path: run folder (best checkpoint; `RUN@last` and `RUN@STEP` name others) or checkpoint folder.
            deterministic: take the most likely action instead of sampling.
            trust: modules, or names `module:attribute`, of your own code that the policy may import.

        Raises:
            CheckpointError: if the checkpoint is missing or damaged.
            ValueError: if the policy names code that is not trusted.
        """
        folder = find_checkpoint(path, "best")
        with one_thread():
            checkpoint = load_checkpoint(folder, policy_only=True, trust=trust)
            return cls(build_policy(checkpoint, folder), checkpoint.record, str(folder), deterministic=deterministic)

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        """Start an episode. If the robot's lidar has more or fewer beams than in training, scans are resampled.

        Raises:
            CheckpointError: if the numbers of beams differ and the training lidar is unknown.
        """
        self._rng, self._is_first, self._beams = rng, True, self._match_beams(robot)

    def __call__(self, observation: dict[str, np.ndarray]) -> Any:
        """Return the action: velocities / limits, shape (2,), float32, or the index of a frontier.

        Raises:
            CheckpointError: if the observation has other names, shapes or dtypes than in training.
        """
        if self._beams is not None and "scan" in observation:
            nearest, in_view, scale = self._beams
            scan = observation["scan"][nearest]
            scan = np.where(scan < 1.0, np.minimum(scan * np.float32(scale), np.float32(1.0)), scan)
            observation = {**observation, "scan": np.where(in_view, scan, np.float32(0.0))}
        actual = {key: (value.shape, str(value.dtype)) for key, value in observation.items()}
        if actual != self._needed:
            needed = ", ".join(f"{key} {space}" for key, space in self._record.observation.items())
            raise CheckpointError(
                f"{self._name} needs observations {needed}; got {actual}. Make the environment with "
                f"observations={self.observations!r}, and with the lidar and settings of the training"
            )
        batch, starts = {key: value[None] for key, value in observation.items()}, np.array([self._is_first])
        self._is_first = False
        with one_thread(), torch.random.fork_rng(devices=[], enabled=not self._deterministic):
            if not self._deterministic:
                torch.manual_seed(int(self._rng.integers(2**63)))
            return self._actor(batch, starts)[0]

    def _match_beams(self, robot: RobotParams) -> tuple[np.ndarray, np.ndarray, float] | None:
        scan = self._record.observation.get("scan")
        if scan is None or len(scan.shape) > 1 or robot.lidar.num_beams == scan.shape[0]:
            return None
        trained = self.arguments.get("robot")
        if trained is None:
            raise CheckpointError(
                f"{self._name} needs scans of {scan.shape[0]} beams, but the lidar of robot {robot.name!r} has "
                f"{robot.lidar.num_beams}; use a robot with the training lidar, or train with environment.robot"
            )
        lidar = load_robot(trained).lidar
        match = lidar.directions.T @ robot.lidar.directions
        in_view = match.max(axis=1) >= math.cos(1.5 * robot.lidar.angle_increment)
        return match.argmax(axis=1), in_view, robot.lidar.range_max / lidar.range_max

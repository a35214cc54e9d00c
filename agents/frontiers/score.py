"""The policy that takes the candidate with the greatest score, and the explorer that drives there."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

from lidarnaut.agents.run_folder import CheckpointError
from lidarnaut.baselines.frontier.explorer import RuleExplorer
from lidarnaut.baselines.frontier.pursuit import PursuitDriving
from lidarnaut.baselines.frontier.rules import nearest
from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.files import printable, read_bytes, read_json, write_folder
from lidarnaut.envs.navigation import FEATURES, NUM_SECTORS, FrontierNavigator, robot_features
from lidarnaut.envs.robots import RobotParams

from .features import NAMES, NUM_FEATURES, PRIOR, score_features
from .tasks import SPLIT

WEIGHTS_FILE, RECORD_FILE = "weights.safetensors", "policy.json"
FAILED = 1e3
"""Taken off the score of candidates that a drive has failed to get to: they come last, as in the rules."""
MAX_CANDIDATES = 48
"""Candidates that are scored at most, as in training."""


class FrontierScore:
    """Scores candidates by a weighted sum of features and takes the best; see `features.NAMES`."""

    level = "decision"
    """What it decides; see `lidarnaut.agents.policies.Level`."""
    end_reason = plan = None
    """A policy never stops by itself, and plans no path."""

    def __init__(self, weights: np.ndarray = PRIOR) -> None:
        """Take weights, shape (NUM_FEATURES,), float64; by default those of the rule `gain_over_cost`.

        Raises:
            ValueError: if there are not as many as features, or one is not finite.
        """
        weights = np.asarray(weights, dtype=np.float64)
        if weights.shape != (NUM_FEATURES,) or not np.isfinite(weights).all():
            raise ValueError(f"weights must be {NUM_FEATURES} finite numbers, got shape {weights.shape}")
        self.weights = weights

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        """Prepare for an episode: nothing is remembered."""

    def __call__(self, observation: dict[str, np.ndarray]) -> np.int64:
        """Return the candidate to go to; those that failed come last."""
        scores = self.rate(observation)[1]
        return np.int64(scores.argmax() if len(scores) else 0)

    def rate(self, observation: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Return features, shape (k, NUM_FEATURES), and scores, shape (k,), of the candidates, float64."""
        count = int(observation["action_mask"].sum())
        features = score_features(
            observation["candidates"], observation["sectors"], observation["gaps"], observation["robot"], count
        )
        return features, features @ self.weights - FAILED * (features[:, NAMES.index("failures")] > 0)

    def save(self, folder: Path, record: Mapping[str, Any]) -> None:
        """Write the weights, and a record of how they were made and of what was held out, to a new folder."""
        about = {"format": 1, "features": list(NAMES), **SPLIT, **record}
        weights = save({"weights": self.weights})
        write_folder(folder, {WEIGHTS_FILE: weights, RECORD_FILE: json.dumps(about, indent=2) + "\n"})

    @classmethod
    def load(cls, folder: str | Path) -> "FrontierScore":
        """Read what `save` wrote; CheckpointError if it is missing, damaged, or of other features."""
        folder = Path(folder)
        try:
            record = read_json(folder / RECORD_FILE)
            if record["features"] != list(NAMES):
                raise ValueError("it was trained on other features than this version computes")
            return cls(load(read_bytes(folder / WEIGHTS_FILE))["weights"])
        except (OSError, ValueError, KeyError, TypeError, RecursionError, SafetensorError) as error:
            raise CheckpointError(f"{folder} holds no frontier policy that can be read: {printable(error)}") from error


class ScoreExplorer(RuleExplorer):
    """Goes to the candidate of the greatest score, and scores anew every four seconds.

    At decision level the score chooses by itself; as an explorer it is not turned back, during a drive, to a goal that
    it has turned away from.
    """

    def __init__(self, score: FrontierScore) -> None:
        """Take a score."""
        super().__init__(nearest, max_candidates=MAX_CANDIDATES)  # the rule is not asked
        self.score = score
        size = MAX_CANDIDATES
        self._observation: dict[str, np.ndarray] = {
            "candidates": np.zeros((size, len(FEATURES)), dtype=np.float32),
            "sectors": np.zeros((size, 2 * NUM_SECTORS), dtype=np.float32),
            "gaps": np.zeros((size, size), dtype=np.float32),
            "action_mask": np.zeros(size, dtype=np.int8),
        }

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        super().reset(robot, control_period, rng)
        self._observation["robot"] = robot_features(robot)

    def rate(self, navigator: FrontierNavigator, belief: Belief) -> np.ndarray:
        seen = self._observation
        navigator.write_features(belief.pose, seen["candidates"], seen["sectors"], seen["gaps"])
        seen["action_mask"][:] = np.arange(MAX_CANDIDATES) < len(navigator.candidates)
        return self.score.rate(seen)[1]


class PursuitScoreExplorer(PursuitDriving, ScoreExplorer):
    """Goes to the same candidates by pursuit driving."""

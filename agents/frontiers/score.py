"""Linear score of frontiers, as a policy and as an explorer."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

from lidarnaut.agents.run_folder import CheckpointError
from lidarnaut.baselines.frontier.pursuit_explorer import PERIOD, PursuitDriving
from lidarnaut.baselines.frontier.rule_explorer import RuleExplorer
from lidarnaut.baselines.frontier.rules import nearest
from lidarnaut.baselines.policy import ObservationPolicy
from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.files import printable, read_bytes, read_json, write_folder
from lidarnaut.envs.navigation import FEATURES, NUM_SECTORS, FrontierNavigator, robot_features

from .features import NAMES, NUM_FEATURES, PRIOR, score_features
from .tasks import SPLIT

WEIGHTS_FILE, RECORD_FILE = "weights.safetensors", "policy.json"
FAILURE_PENALTY = 1e3
"""Penalty on the score of a frontier after a failed drive to it."""
MAX_CANDIDATES = 48
PRETRAINED = Path(__file__).parents[1] / "pretrained"


class FrontierScore(ObservationPolicy):
    """Policy that selects the frontier candidate with the largest weighted sum of features."""

    level = "decision"

    def __init__(self, weights: np.ndarray = PRIOR) -> None:
        """Set the feature weights, shape (NUM_FEATURES,), float64; raise ValueError if invalid."""
        weights = np.asarray(weights, dtype=np.float64)
        if weights.shape != (NUM_FEATURES,) or not np.isfinite(weights).all():
            raise ValueError(f"weights must be {NUM_FEATURES} finite numbers, got shape {weights.shape}")
        self.weights = weights

    def __call__(self, observation: dict[str, np.ndarray]) -> np.int64:
        scores = self.rate(observation)[1]
        return np.int64(scores.argmax() if len(scores) else 0)

    def rate(self, observation: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Return features, shape (k, NUM_FEATURES), and scores, shape (k,), float64, of all k frontier candidates."""
        count = int(observation["action_mask"].sum())
        candidates, sectors, gaps, robot = (observation[name] for name in ("candidates", "sectors", "gaps", "robot"))
        features = score_features(candidates, sectors, gaps, robot, count)
        return features, features @ self.weights - FAILURE_PENALTY * (features[:, NAMES.index("failures")] > 0)

    def save(self, folder: Path, record: Mapping[str, Any]) -> None:
        """Write weights to a folder, with training results `record` and names of held-out worlds and robots."""
        about = {"format": 1, "features": list(NAMES), **SPLIT, **record}
        weights = save({"weights": self.weights})
        write_folder(folder, {WEIGHTS_FILE: weights, RECORD_FILE: json.dumps(about, indent=2) + "\n"})

    @classmethod
    def load(cls, folder: str | Path) -> "FrontierScore":
        """Load a score from a folder; raise CheckpointError if unreadable."""
        folder = Path(folder)
        try:
            record = read_json(folder / RECORD_FILE)
            if record["features"] != list(NAMES):
                raise ValueError("its features differ from those of this version")
            return cls(load(read_bytes(folder / WEIGHTS_FILE))["weights"])
        except (OSError, ValueError, KeyError, TypeError, RecursionError, SafetensorError) as error:
            raise CheckpointError(f"{folder} holds no readable frontier score: {printable(error)}") from error


class ScoreRating:
    """Rating of all reachable frontiers by a score, for `ScoreExplorer` and the observation `Plan`."""

    def __init__(self, score: FrontierScore) -> None:
        self._score, size = score, MAX_CANDIDATES
        self._observation: dict[str, np.ndarray] = {
            "candidates": np.zeros((size, len(FEATURES)), dtype=np.float32),
            "sectors": np.zeros((size, 2 * NUM_SECTORS), dtype=np.float32),
            "gaps": np.zeros((size, size), dtype=np.float32),
            "action_mask": np.zeros(size, dtype=np.int8),
        }

    def __call__(self, navigator: FrontierNavigator, belief: Belief) -> np.ndarray:
        """Return the scores of the navigator's k <= MAX_CANDIDATES candidates, shape (k,), float64; else ValueError."""
        seen, count = self._observation, len(navigator.candidates)
        if count > MAX_CANDIDATES:
            raise ValueError(f"max_candidates must be at most {MAX_CANDIDATES} with a score, got {count} candidates")
        navigator.write_features(belief.pose, seen["candidates"], seen["sectors"], seen["gaps"])
        seen["robot"] = robot_features(navigator.robot)
        seen["action_mask"][:] = np.arange(MAX_CANDIDATES) < count
        return self._score.rate(seen)[1]


def pretrained_rating() -> ScoreRating:
    """Return the rating of `learned:pretrained/frontiers`."""
    return ScoreRating(FrontierScore.load(PRETRAINED / "frontiers"))


class ScoreExplorer(RuleExplorer):
    """Explorer that drives to the frontier with the highest score, reselected every four seconds.

    During a drive, abandoned frontiers are not selected again.
    """

    def __init__(self, score: FrontierScore) -> None:
        super().__init__(nearest, max_candidates=MAX_CANDIDATES)
        self.score, self._rating = score, ScoreRating(score)

    def rate(self, navigator: FrontierNavigator, belief: Belief) -> np.ndarray:
        return self._rating(navigator, belief)


class PursuitScoreExplorer(PursuitDriving, ScoreExplorer):
    """Explorer that selects frontiers like `ScoreExplorer`, each second, and steers to a point ahead on the path."""

    def __init__(self, score: FrontierScore) -> None:
        super().__init__(score)
        self.max_time = PERIOD

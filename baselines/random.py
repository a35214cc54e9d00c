"""The explorer that any other must beat."""

import numpy as np

from envs.robots import RobotParams
from envs.slam import Belief


class RandomExplorer:
    """Draws every action uniformly from the action space."""

    end_reason: str | None = None
    """Never stops."""
    plan: np.ndarray | None = None
    """Never plans."""

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        """Prepare for a new episode; see `Explorer`."""
        self._rng = rng

    def act(self, observation: dict[str, np.ndarray], belief: Belief) -> np.ndarray:
        """Return the action; see `Explorer`."""
        return self._rng.uniform(-1.0, 1.0, 2).astype(np.float32)

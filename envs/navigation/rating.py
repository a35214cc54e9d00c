"""What a frontier candidate is worth: unknown area in view over the length of the path.

After González-Baños and Latombe, "Navigation strategies for exploring indoor environments" (2002), who take
`gain * exp(-cost)`; a ratio prefers the same near views, and does not give up on far ones.
"""

from dataclasses import dataclass

import numpy as np

from .candidate_features import Candidates


@dataclass(frozen=True, slots=True)
class GainOverCostParams:
    """How to value a view."""

    least_gain: float = 0.3
    """Added to the visible unknown area [m2]: what looking at a frontier is worth where nothing seems to lie behind."""
    least_cost: float = 3.0
    """Added to the cost of the path [m]: the smaller, the more the nearest frontier counts."""

    def __post_init__(self) -> None:
        for name in ("least_gain", "least_cost"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")


def gain_over_cost(candidates: Candidates, params: GainOverCostParams = GainOverCostParams()) -> np.ndarray:
    """Return the logarithms of `(gain + least_gain) / (cost + least_cost)`, shape (k,), float64."""
    return np.log(candidates.visible + params.least_gain) - np.log(candidates.costs + params.least_cost)

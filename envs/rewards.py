"""What a step is worth: the weights of the reward terms that `info["rewards"]` names, and whose sum is the reward."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, Self


@dataclass(frozen=True, slots=True)
class _Weights:
    """Weights of reward terms."""

    def __post_init__(self) -> None:
        for name, weight in asdict(self).items():
            if not math.isfinite(weight):
                raise ValueError(f"reward weight {name!r} must be finite, got {weight!r}")

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Return the names of the terms, in the order in which they are summed."""
        return tuple(field.name for field in fields(cls))

    @classmethod
    def of(cls, weights: Self | Mapping[str, float]) -> Self:
        """Return weights that users gave as such or as a mapping; what a mapping leaves out has its default.

        Raises:
            ValueError: if there is no such term, or a weight is not finite.
        """
        if isinstance(weights, cls):
            return weights
        assert isinstance(weights, Mapping)
        if unknown := sorted(set(weights) - set(cls.names())):
            raise ValueError(f"reward has unknown terms {unknown}; allowed are {list(cls.names())}")
        return cls(**weights)


@dataclass(frozen=True, slots=True)
class RewardWeights(_Weights):
    """What a step of an exploration is worth."""

    explored: float = 1.0
    """For area that became truly known [1/m2]."""
    time: float = -0.02
    """For time that passes [1/s]."""
    collision: float = -0.5
    """For time in contact with anything [1/s]."""
    completed: float = 10.0
    """Once, when the target coverage is reached."""

    def terms(self, gained: Any, touching: Any, completed: Any, period: Any) -> dict[str, Any]:
        """Return the reward terms of a step, or arrays of them.

        Args:
            gained: area that became truly known [m2].
            touching: whether the robot touched anything, or the share of the step for which it did.
            completed: whether the target coverage is reached.
            period: length of the step [s].
        """
        return {
            "explored": self.explored * gained,
            "time": self.time * period,
            "collision": self.collision * period * touching,
            "completed": self.completed * completed,
        }


@dataclass(frozen=True, slots=True)
class NavigateRewards(_Weights):
    """What a step on the way to a goal is worth."""

    progress: float = 1.0
    """For the true way to the goal that became shorter [1/m]."""
    time: float = -0.02
    """For time that passes [1/s]."""
    collision: float = -0.5
    """For time in contact with anything [1/s]."""
    reached: float = 10.0
    """Once, when the goal is reached."""

    def terms(self, gained: float, touching: bool, reached: bool, period: float) -> dict[str, float]:
        """Return the reward terms of a step.

        Args:
            gained: by how much the true way to the goal became shorter [m].
            touching: whether the robot touched anything.
            reached: whether it is at the goal.
            period: length of the step [s].
        """
        return {
            "progress": self.progress * gained,
            "time": self.time * period,
            "collision": self.collision * period * touching,
            "reached": self.reached * reached,
        }


@dataclass(frozen=True, slots=True)
class TrackRewards(_Weights):
    """What a step along a route is worth."""

    progress: float = 1.0
    """For the way made along the route [1/m]."""
    deviation: float = -2.0
    """For being off the route [1/(m s)]."""
    time: float = -0.02
    """For time that passes [1/s]."""
    collision: float = -0.5
    """For time in contact with anything [1/s]."""
    completed: float = 10.0
    """Once, at the end of the route."""

    def terms(
        self, gained: float, deviation: float, touching: bool, completed: bool, period: float
    ) -> dict[str, float]:
        """Return the reward terms of a step.

        Args:
            gained: way made along the route [m].
            deviation: distance from it [m].
            touching: whether the robot touched anything.
            completed: whether the end of the route is reached.
            period: length of the step [s].
        """
        return {
            "progress": self.progress * gained,
            "deviation": self.deviation * period * deviation,
            "time": self.time * period,
            "collision": self.collision * period * touching,
            "completed": self.completed * completed,
        }

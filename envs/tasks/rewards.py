"""Reward terms: `info["rewards"]` names them, and the reward is their sum."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from functools import cache
from typing import Any, Self

from envs.arguments import is_number
from envs.files import resolve


@dataclass(frozen=True, slots=True)
class Weights:
    """Weights of reward terms. A term is a field here, and an entry of what the task's `quantities` returns."""

    def __post_init__(self) -> None:
        for name, weight in asdict(self).items():
            if not is_number(weight):
                raise ValueError(f"reward weight {name!r} must be finite, got {weight!r}")

    @classmethod
    @cache
    def names(cls) -> tuple[str, ...]:
        """Return the names of the terms, in the order in which they are summed."""
        return tuple(field.name for field in fields(cls))

    @classmethod
    def of(cls, weights: "Self | Mapping[str, float] | str") -> Self:
        """Return weights that users gave as such, as a mapping, or as `module:attribute` of either.

        What a mapping leaves out has its default. A subclass may add terms: fields, and what its `terms` makes of the
        task's quantities.

        Raises:
            ValueError: if there is no such term, or a weight is not finite.
        """
        weights = resolve(weights, {}, "reward")
        if isinstance(weights, type) and issubclass(weights, cls):
            return weights()
        if isinstance(weights, cls):
            return weights
        if not isinstance(weights, Mapping):
            raise ValueError(f"reward must be {cls.__name__} or a mapping of its terms, got {weights!r}")
        if unknown := sorted(set(weights) - set(cls.names())):
            raise ValueError(f"reward has unknown terms {unknown}; allowed are {list(cls.names())}")
        return cls(**weights)

    def terms(self, quantities: Mapping[str, float]) -> dict[str, float]:
        """Return the reward terms of a step: each quantity of the task, in the field's unit, times its weight."""
        return {name: getattr(self, name) * quantities[name] for name in self.names()}


class Terms:
    """Weights of reward terms by name: each quantity of a task that has one counts as often."""

    def __init__(self, weights: Mapping[str, float], changes: Any = None) -> None:
        """Take the weights, and changes of some, which may be `module:attribute` of a mapping.

        Raises:
            ValueError: if there is no such term, or a weight is not finite.
        """
        changes = resolve(changes, {}, "reward") or {}
        if not isinstance(changes, Mapping):
            raise ValueError(f"reward must be a mapping of the terms {list(weights)}, got {changes!r}")
        if unknown := sorted(set(changes) - set(weights)):
            raise ValueError(f"reward has unknown terms {unknown}; allowed are {list(weights)}")
        self._weights = {**weights, **changes}
        for name, weight in self._weights.items():
            if not is_number(weight):
                raise ValueError(f"reward weight {name!r} must be finite, got {weight!r}")

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Terms) and self._weights == other._weights

    def names(self) -> tuple[str, ...]:
        """Return the names of the terms, in the order in which they are summed."""
        return tuple(self._weights)

    def terms(self, quantities: Mapping[str, float]) -> dict[str, float]:
        """Return the reward terms of a step: each quantity of the task, in the field's unit, times its weight."""
        return {name: weight * quantities[name] for name, weight in self._weights.items()}


@dataclass(frozen=True, slots=True)
class RewardWeights(Weights):
    """Weights of an exploration's reward terms."""

    explored: float = 1.0
    """For area that became explored [1/m2]."""
    time: float = -0.02
    """For time that passes [1/s]."""
    collision: float = -0.5
    """For time in contact with anything [1/s]."""
    completed: float = 10.0
    """Once, when the target coverage is reached."""


@dataclass(frozen=True, slots=True)
class ReturnRewards(RewardWeights):
    """Weights of the reward terms of an exploration after which the robot returns."""

    returned: float = 10.0
    """Once, when the robot is back at its start."""


@dataclass(frozen=True, slots=True)
class NavigateRewards(Weights):
    """Weights of the reward terms of driving to a goal."""

    progress: float = 1.0
    """For the geodesic distance to the goal that became shorter [1/m]."""
    time: float = -0.02
    """For time that passes [1/s]."""
    collision: float = -0.5
    """For time in contact with anything [1/s]."""
    reached: float = 10.0
    """Once, when the goal is reached."""


@dataclass(frozen=True, slots=True)
class TrackRewards(Weights):
    """Weights of the reward terms along a route."""

    progress: float = 1.0
    """For distance made along the route [1/m]."""
    deviation: float = -2.0
    """For distance from the route times time [1/(m s)]."""
    time: float = -0.02
    """For time that passes [1/s]."""
    collision: float = -0.5
    """For time in contact with anything [1/s]."""
    completed: float = 10.0
    """Once, at the end of the route."""

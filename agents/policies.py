"""Adapters to the policy interface for user-defined policies."""

import inspect
from collections.abc import Callable, Mapping
from typing import Any, Literal, get_args

import numpy as np
from gymnasium import spaces

from lidarnaut.baselines.frontier.rule_explorer import RuleExplorer
from lidarnaut.baselines.policy import OnePerRobot, Policy
from lidarnaut.envs.files import SHORT
from lidarnaut.envs.robots import RobotParams

Level = Literal["twist", "decision"]
"""Kind of action: `twist` (velocity command), or `decision` (choice of a frontier in `ExploreFrontiers-v0`)."""


def make_policy(value: Any, space: spaces.Space | None = None) -> Policy:
    """Return a policy made from an explorer, model, callable or factory.

    - A frontier rule: `rule(candidates, belief)` returns the scores of frontier candidates.
    - An `Explorer`: `reset` and `act(reading, belief)`, optionally `end_reason` and `plan`. In a team, each robot gets
      a copy, unless `is_team` is true.
    - A model: `predict(observation)` returns the action, alone or first in a tuple. Accepted arguments among
      `deterministic=True`, `action_masks` and `state` are passed. An optional `reset(robot, control_period, rng)` is
      called before each episode.
    - Any other callable of one argument: returns the action for an observation.
    - A class, or a function without required arguments: returns one of the above.

    Actions outside of a `Box` action space `space` are clipped.

    Raises:
        ValueError: if `value` is none of the above.
    """
    is_function = callable(value) and not hasattr(value, "act") and not hasattr(value, "predict")
    if isinstance(value, type) or (is_function and _takes(value, 0)):
        value = value()
    if hasattr(value, "act"):
        if not hasattr(value, "reset"):
            raise ValueError(f"explorer {value!r} lacks reset; see lidarnaut.baselines.policy.Explorer")
        for name in {"end_reason", "plan"} - {*dir(value)}:
            setattr(value, name, None)
        is_team = space is not None and len(space.shape or ()) > 1
        return OnePerRobot(value) if is_team and not getattr(value, "is_team", False) else value
    if callable(value) and not hasattr(value, "predict") and _takes(value, 2) and not _takes(value, 1):
        return RuleExplorer(value)
    if callable(value) or hasattr(value, "predict"):
        return CalledPolicy(value, space)
    raise ValueError(
        f"{SHORT.repr(value)} is not an explorer, rule or callable of an observation, and lacks predict(observation)"
    )


def level_of(value: Any) -> Level:
    """Return the kind of a policy's actions, `twist` (default) or `decision`; ValueError if unknown."""
    level: Level = getattr(value, "level", "twist")
    if level not in get_args(Level):
        raise ValueError(f"level of {value!r} must be one of {', '.join(get_args(Level))}, got {level!r}")
    return level


def needed_arguments(value: Any) -> dict[str, Any]:
    """Return the environment arguments that a policy requires: names of observations, and collision monitor.

    Raises:
        ValueError: if the policy's attribute `observations` is invalid.
    """
    parts = getattr(value, "observations", None)
    if parts is not None and (isinstance(parts, str) or not all(isinstance(part, str) for part in parts)):
        raise ValueError(f"observations of {value!r} must be names of parts, got {parts!r}")
    needed = {} if parts is None else {"observations": parts if isinstance(parts, Mapping) else tuple(parts)}
    return needed | ({"collision_monitor": True} if getattr(value, "collision_monitor", False) else {})


class CalledPolicy:
    """Adapter that makes a policy from a callable, or from a model with `predict`."""

    end_reason: str | None
    plan: np.ndarray | None
    control_hz: float | None

    def __init__(self, policy: Any, space: spaces.Space | None = None) -> None:
        self._policy, self._space = policy, space
        self._predicts = hasattr(policy, "predict")
        self._takes = inspect.signature(policy.predict).parameters if self._predicts else {}
        self._state: Any = None

    def __getattr__(self, name: str) -> Any:
        if name not in ("end_reason", "plan", "control_hz", "uses_ground_truth"):
            raise AttributeError(name)
        return getattr(self._policy, name, None)

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        self._state = None
        if hasattr(self._policy, "reset") and (not self._predicts or _takes(self._policy.reset, 3)):
            self._policy.reset(robot, control_period, rng)

    def __call__(self, observation: dict[str, np.ndarray]) -> Any:
        action = self._predict(observation) if self._predicts else self._policy(observation)
        if isinstance(self._space, spaces.Box):
            action = np.asarray(action, dtype=self._space.dtype)
            return np.clip(action, self._space.low, self._space.high)
        return np.int64(action) if isinstance(self._space, spaces.Discrete) else action

    def _predict(self, observation: dict[str, np.ndarray]) -> Any:
        offered = {"deterministic": True, "action_masks": observation.get("action_mask"), "state": self._state}
        offered["episode_start"] = np.array([self._state is None])
        arguments = {name: value for name, value in offered.items() if name in self._takes and value is not None}
        result = self._policy.predict(observation, **arguments)
        if not isinstance(result, tuple):
            return result
        self._state = result[1] if len(result) > 1 else None
        return result[0]


def _takes(function: Callable[..., Any], count: int) -> bool:
    try:
        return inspect.signature(function).bind(*range(count)) is not None
    except (TypeError, ValueError):
        return False

"""Adapters to the policy interface for user-defined policies."""

import inspect
from collections.abc import Callable, Mapping
from typing import Any, get_args

import numpy as np
from gymnasium import spaces

from lidarnaut.baselines.frontier.rule_explorer import RuleExplorer
from lidarnaut.baselines.policy import Explorer, Level, ObservationPolicy, OnePerRobot, Policy, adopt
from lidarnaut.envs.files import SHORT
from lidarnaut.envs.robots import RobotParams

DECLARED = ("level", "observations", "collision_monitor", "control_hz", "uses_ground_truth")
"""Attributes that a policy has from a model, or from the function that returns the policy."""


def make_policy(value: Any, space: spaces.Space | None = None) -> Policy:
    """Return a policy made from an explorer, model, callable or factory.

    - A frontier rule: `rule(candidates, belief)` returns the scores of frontier candidates.
    - An `Explorer`, or an object with `act(reading, belief)`, which gets the defaults of `Explorer`. In a team, each
      robot gets a copy, unless `is_team` is true.
    - A model: `predict(observation)` returns the action, alone or first in a tuple. Accepted arguments among
      `deterministic=True`, `action_masks` and `state` are passed. An optional `reset(robot, control_period, rng)` is
      called before each episode.
    - Any other callable of one argument: returns the action for an observation.
    - A class, or a function without required arguments: returns one of the above.

    Actions outside of a `Box` action space `space` are clipped.

    Raises:
        ValueError: if `value` is none of the above, or its `level` is unknown.
    """
    source = value
    is_function = callable(value) and not hasattr(value, "act") and not hasattr(value, "predict")
    if isinstance(value, type) or (is_function and _takes(value, 0)):
        value = value()
    policy = _adapted(value, space)
    for one in (source, value):
        if one is not policy and not isinstance(one, type):
            vars(policy).update({name: getattr(one, name) for name in DECLARED if hasattr(one, name)})
    if policy.level not in (None, *get_args(Level)):
        raise ValueError(f"level of {value!r} must be one of {', '.join(get_args(Level))}, got {policy.level!r}")
    is_team = space is not None and len(space.shape or ()) > 1
    return OnePerRobot(policy) if is_team and isinstance(policy, Explorer) and not policy.is_team else policy


def _adapted(value: Any, space: spaces.Space | None) -> Policy:
    if isinstance(value, Policy):
        return value
    if hasattr(value, "act"):
        return adopt(value)
    if callable(value) and not hasattr(value, "predict") and _takes(value, 2) and not _takes(value, 1):
        return RuleExplorer(value)
    if callable(value) or hasattr(value, "predict"):
        return CalledPolicy(value, space)
    raise ValueError(
        f"{SHORT.repr(value)} is not an explorer, rule or callable of an observation, and lacks predict(observation)"
    )


def needed_arguments(policy: Policy) -> dict[str, Any]:
    """Return the environment arguments that a policy requires: names of observations, and collision monitor.

    Raises:
        ValueError: if the policy's attribute `observations` is invalid.
    """
    parts = policy.observations
    if parts is not None and (isinstance(parts, str) or not all(isinstance(part, str) for part in parts)):
        raise ValueError(f"observations of {policy!r} must be names of parts, got {parts!r}")
    needed = {} if parts is None else {"observations": parts if isinstance(parts, Mapping) else tuple(parts)}
    return needed | ({"collision_monitor": True} if policy.collision_monitor else {})


class CalledPolicy(ObservationPolicy):
    """Adapter that makes a policy from a callable, or from a model with `predict`."""

    def __init__(self, policy: Any, space: spaces.Space | None = None) -> None:
        self._policy, self._space = policy, space
        self._predicts = hasattr(policy, "predict")
        self._takes = inspect.signature(policy.predict).parameters if self._predicts else {}
        self._state: Any = None

    @property
    def end_reason(self) -> str | None:  # type: ignore[override]
        return getattr(self._policy, "end_reason", None)

    @property
    def plan(self) -> np.ndarray | None:  # type: ignore[override]
        return getattr(self._policy, "plan", None)

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

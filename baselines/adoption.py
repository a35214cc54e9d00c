"""Adapters to the policy interface for user-defined policies, which they leave as they are."""

import inspect
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, get_args

import numpy as np
from gymnasium import spaces

from lidarnaut.envs.files import SHORT
from lidarnaut.envs.robots import RobotParams

from .frontier.rule_explorer import RuleExplorer
from .policy import Explorer, Level, ObservationPolicy, OnePerRobot, Policy, wrap

DECLARED = ("level", "observations", "collision_monitor", "control_hz", "uses_ground_truth")
"""Attributes that the function which returns a policy may declare for the policy."""
OBSERVATION = ("observation", "observations", "obs")
"""Names of an optional first argument that distinguish a policy from a function that returns one."""


def adopt(value: Any, space: spaces.Space | None = None) -> Policy:
    """Return a policy made from an explorer, model, callable or factory.

    - A frontier rule: `rule(candidates, belief)` returns the scores of frontier candidates.
    - An `Explorer`, or an object with `act(reading, belief)`. In a team, each robot gets a copy, unless `is_team` is
      true.
    - A model: `predict(observation)` returns the action, alone or first in a tuple. Accepted arguments among
      `deterministic=True`, `action_masks` and `state` are passed. An optional `reset(robot, control_period, rng)` is
      called before each episode.
    - Any other callable of one argument: returns the action for an observation.
    - A class, or a function without required arguments: returns one of the above. A function whose first argument is
      called `observation` or `obs` is a policy.

    Objects of other classes keep their class and attributes: the policy refers to the object, and has the defaults of
    `Explorer` or `ObservationPolicy` for what it lacks. Actions outside of a `Box` action space `space` are clipped.

    Raises:
        ValueError: if `value` is none of the above, or its `level` is unknown.
    """
    if isinstance(value, str | Path):
        raise ValueError(f"{SHORT.repr(value)} is a name, not a policy: lidarnaut.make_policy(NAME, env) makes it")
    source = value
    while _is_factory(value):
        try:
            value = value()
        except TypeError as error:
            raise TypeError(f"{SHORT.repr(value)} was called without arguments to make a policy: {error}") from error
    called = f", which {SHORT.repr(source)} returned when called without arguments," if source is not value else ""
    policy = _adopted(value, space, called)
    if source is not value and not isinstance(source, type) and (declared := _declared_by(source)):
        if policy is value:
            policy = wrap(value, Explorer if isinstance(value, Explorer) else CalledPolicy, **declared)
        vars(policy).update(declared)
    if policy.level not in (None, *get_args(Level)):
        raise ValueError(f"level of {value!r} must be one of {', '.join(get_args(Level))}, got {policy.level!r}")
    is_team = space is not None and len(space.shape or ()) > 1
    return OnePerRobot(policy) if is_team and isinstance(policy, Explorer) and not policy.is_team else policy


def _adopted(value: Any, space: spaces.Space | None, called: str) -> Policy:
    if isinstance(value, Policy):
        return value
    if hasattr(value, "act"):
        return wrap(value, Explorer)
    if callable(value) and not hasattr(value, "predict") and _takes(value, 2) and not _takes(value, 1):
        explorer = RuleExplorer(value)
        vars(explorer).update(_declared_by(value))
        return explorer
    if callable(value) or hasattr(value, "predict"):
        options = (*inspect.signature(value.predict).parameters,) if hasattr(value, "predict") else ()
        return wrap(value, CalledPolicy, _space=space, _options=options, _state=None)
    raise ValueError(
        f"{SHORT.repr(value)}{called} is not an explorer, rule or callable of an observation, and lacks "
        "predict(observation)"
    )


def _declared_by(source: Any) -> dict[str, Any]:
    return {name: getattr(source, name) for name in DECLARED if hasattr(source, name)}


def _is_factory(value: Any) -> bool:
    if isinstance(value, type):
        return True
    is_policy = isinstance(value, Policy) or hasattr(value, "act") or hasattr(value, "predict")
    if is_policy or not callable(value) or not _takes(value, 0):
        return False
    if not _takes(value, 1):
        return True
    first = next(iter(inspect.signature(value).parameters.values()))
    is_function = inspect.isroutine(value) or isinstance(value, partial)
    return is_function and first.kind is not first.VAR_POSITIONAL and first.name not in OBSERVATION


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

    _kept = ("reset", "_predict")
    """Names that the object cannot replace."""
    _value: Any
    _space: spaces.Space | None = None
    _options: Iterable[str] = ()  # arguments that `predict` accepts
    _state: Any = None

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        super().reset(robot, control_period, rng)
        vars(self)["_state"] = None
        reset = getattr(self._value, "reset", None)
        if reset and (not hasattr(self._value, "predict") or _takes(reset, 3)):
            reset(robot, control_period, rng)

    def __call__(self, observation: dict[str, np.ndarray]) -> Any:
        action = self._predict(observation) if hasattr(self._value, "predict") else self._value(observation)
        if isinstance(self._space, spaces.Box):
            action = np.asarray(action, dtype=self._space.dtype)
            return np.clip(action, self._space.low, self._space.high)
        return np.int64(action) if isinstance(self._space, spaces.Discrete) else action

    def _predict(self, observation: dict[str, np.ndarray]) -> Any:
        offered = {"deterministic": True, "action_masks": observation.get("action_mask"), "state": self._state}
        offered["episode_start"] = np.array([self._state is None])
        arguments = {name: offered[name] for name in self._options if offered.get(name) is not None}
        result = self._value.predict(observation, **arguments)
        if not isinstance(result, tuple):
            return result
        vars(self)["_state"] = result[1] if len(result) > 1 else None
        return result[0]


def _takes(function: Callable[..., Any], count: int) -> bool:
    try:
        return inspect.signature(function).bind(*range(count)) is not None
    except (TypeError, ValueError):
        return False

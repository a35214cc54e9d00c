"""Policies of the user's own, from any library, adapted to the episode loop."""

import inspect
from collections.abc import Callable, Mapping
from typing import Any, Literal, get_args

import numpy as np
from gymnasium import spaces

from lidarnaut.baselines.explorer import OnePerRobot, Policy
from lidarnaut.baselines.frontier.explorer import RuleExplorer
from lidarnaut.envs.robots import RobotParams

Level = Literal["twist", "decision"]
"""What a policy decides: twists, or which frontier to go to in `ExploreFrontiers-v0`."""


def make_policy(value: Any, space: spaces.Space | None = None) -> Policy:
    """Return what drives, made from an explorer, a policy, or a class or function that makes one.

    - A frontier rule: a callable of two arguments, `rule(candidates, belief)`, which returns their scores.
    - An `Explorer`: has `reset` and `act(reading, belief)`, and may have `end_reason` and `plan`. In a team, each robot
      gets a copy, unless it has `is_team` and drives all of them.
    - A model with `predict(observation)`, which returns the action, alone or first in a tuple as in
      stable-baselines3. It is asked for `deterministic=True`, and given `action_masks` and `state`, if it takes them.
      Its `reset(robot, control_period, rng)`, if it has one, is called before each episode.
    - Any other callable of one argument: gets the observation and returns the action.
    - A class, or a function without required arguments: makes one of these.

    Args:
        value: one of the above.
        space: action space; actions outside a `Box` are cut to its bounds.

    Raises:
        ValueError: if it is none of them.
    """
    is_function = callable(value) and not hasattr(value, "act") and not hasattr(value, "predict")
    if isinstance(value, type) or (is_function and _takes(value, 0)):
        value = value()
    if hasattr(value, "act"):
        if not hasattr(value, "reset"):
            raise ValueError(f"explorer {value!r} lacks reset; see lidarnaut.baselines.explorer.Explorer")
        for name in {"end_reason", "plan"} - {*dir(value)}:  # properties may need a reset
            setattr(value, name, None)
        is_team = space is not None and len(space.shape or ()) > 1
        return OnePerRobot(value) if is_team and not getattr(value, "is_team", False) else value
    if callable(value) and not hasattr(value, "predict") and _takes(value, 2) and not _takes(value, 1):
        return RuleExplorer(value)
    if callable(value) or hasattr(value, "predict"):
        return CalledPolicy(value, space)
    raise ValueError(f"{value!r} is no explorer, rule or callable of an observation, and has no predict(observation)")


def level_of(value: Any) -> Level:
    """Return the level at which a policy decides, its `level`; twists without one; ValueError for any other."""
    level: Level = getattr(value, "level", "twist")
    if level not in get_args(Level):
        raise ValueError(f"level of {value!r} must be one of {', '.join(get_args(Level))}, got {level!r}")
    return level


def needed_arguments(value: Any) -> dict[str, Any]:
    """Return the arguments of the environment that a policy needs, as far as it has attributes of their names.

    They are `observations`, and `collision_monitor` where it drives with one. ValueError if observations are not named.
    """
    parts = getattr(value, "observations", None)
    if parts is not None and (isinstance(parts, str) or not all(isinstance(part, str) for part in parts)):
        raise ValueError(f"observations of {value!r} must be names of parts, got {parts!r}")
    needed = {} if parts is None else {"observations": parts if isinstance(parts, Mapping) else tuple(parts)}
    return needed | ({"collision_monitor": True} if getattr(value, "collision_monitor", False) else {})


class CalledPolicy:
    """A policy that is called with observations, or asked to `predict` in the manner of stable-baselines3."""

    end_reason: str | None
    plan: np.ndarray | None
    control_hz: float | None

    def __init__(self, policy: Any, space: spaces.Space | None = None) -> None:
        """Take a policy, and the action space; see `make_policy`."""
        self._policy, self._space = policy, space
        self._predicts = hasattr(policy, "predict")
        self._takes = inspect.signature(policy.predict).parameters if self._predicts else {}
        self._state: Any = None

    def __getattr__(self, name: str) -> Any:
        """Return an optional attribute of the policy; None if the policy lacks it."""
        if name not in ("end_reason", "plan", "control_hz", "uses_ground_truth"):
            raise AttributeError(name)
        return getattr(self._policy, name, None)

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        self._state = None
        if hasattr(self._policy, "reset") and (not self._predicts or _takes(self._policy.reset, 3)):
            self._policy.reset(robot, control_period, rng)

    def __call__(self, observation: dict[str, np.ndarray]) -> Any:
        """Return the action for an observation, within the bounds of the action space."""
        action = self._predict(observation) if self._predicts else self._policy(observation)
        if isinstance(self._space, spaces.Box):
            action = np.asarray(action, dtype=self._space.dtype)
            return np.clip(action, self._space.low, self._space.high)
        return np.int64(action) if isinstance(self._space, spaces.Discrete) else action

    def _predict(self, observation: dict[str, np.ndarray]) -> Any:
        """Call `predict` with the arguments that the model supports."""
        offered = {"deterministic": True, "action_masks": observation.get("action_mask"), "state": self._state}
        offered["episode_start"] = np.array([self._state is None])
        arguments = {name: value for name, value in offered.items() if name in self._takes and value is not None}
        result = self._policy.predict(observation, **arguments)
        if not isinstance(result, tuple):
            return result
        self._state = result[1] if len(result) > 1 else None
        return result[0]


def _takes(function: Callable[..., Any], count: int) -> bool:
    """Return True if a function can be called with `count` positional arguments."""
    try:
        return inspect.signature(function).bind(*range(count)) is not None
    except (TypeError, ValueError):  # built-in functions may have no signature
        return False

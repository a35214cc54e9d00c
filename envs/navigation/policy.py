"""Base classes of policies. All members except the action have defaults."""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np

from lidarnaut.envs.estimation import Belief
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.navigation.frontiers.candidates import Markers
from lidarnaut.envs.navigation.frontiers.frontier_navigator import FrontierNavigator
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Reading, Twist

Level = Literal["twist", "decision"]
"""Kind of action: `twist` (velocity command), or `decision` (choice of a frontier in `ExploreFrontiers-v0`)."""


class Policy:
    """Base of `Explorer` and `ObservationPolicy`."""

    robot: RobotParams
    """Robot of the episode."""
    control_period: float
    """Time between actions [s]."""
    rng: np.random.Generator
    """Random generator of the policy."""
    id: str = ""
    """Environment of the policy's training; empty if unknown."""
    level: Level | None = None
    """Kind of action; None if not declared."""
    observations: Sequence[str] | Mapping[str, Any] | None = None
    """Observation parts that the policy requires, as for `gymnasium.make`; None for the environment's default."""
    collision_monitor: bool = False
    """Whether the policy requires the collision monitor."""
    control_hz: float | None = None
    """Actions per second, repeated in between [Hz]; None for the environment's rate."""
    uses_ground_truth: bool = False
    """Whether the policy uses ground truth, and is a bound for other policies."""
    is_team: bool = False
    """Whether `act` takes lists of readings and beliefs and returns a list of twists, one per robot."""
    end_reason: str | None = None
    """Reason why the policy stopped, such as `"no_reachable_frontier"`; None while active."""
    plan: np.ndarray | None = None
    """Planned path for rendering, shape (n, 2), map frame [m]; None without a path."""
    markers: Markers | None = None
    """Goals and random trees that the policy considers; read for pictures and recorded samples only."""
    tracks: np.ndarray | None = None
    """Tracked people for rendering, as `Belief.people`; None for those of the estimate."""
    navigator: FrontierNavigator | None = None
    """Navigator whose frontier candidates are recorded; None for none."""
    scores: np.ndarray | None = None
    """Scores of the candidates of `navigator`, shape (k,); None for none."""
    status: str = ""
    """State of the policy for the log."""

    @property
    def plans(self) -> list[np.ndarray | None]:
        """Planned path of each robot, as `plan`."""
        return [self.plan]

    def reset(self, robot: RobotParams, control_period: float, rng: np.random.Generator) -> None:
        """Prepare the policy for an episode, and store the arguments.

        `control_period`: time between actions [s]. `rng`: random generator of the policy.
        """
        vars(self).update(robot=robot, control_period=control_period, rng=rng)  # also of frozen dataclasses

    def set_goal(self, goal: Pose2D) -> None:
        """Receive the goal of the task, map frame, at the start and after changes.

        If only the bearing is known, `goal` is a point in the direction of the goal.
        """

    def set_tolerances(self, distance: float, heading: float) -> None:
        """Receive the goal tolerances of the task [m, rad], before `set_goal`."""

    def set_route(self, route: Any) -> None:
        """Receive the route of the task, `lidarnaut.envs.tasks.route.Route`."""


class Explorer(Policy):
    """Policy that computes velocities from sensor data, estimated pose and map, without ground truth."""

    def act(self, reading: Reading, belief: Belief) -> Twist:
        """Return the velocity command for the next control period, which is clipped to the robot's limits.

        `reading`: sensor data. `belief`: estimated pose and map.
        """
        raise NotImplementedError(f"{type(self).__name__} must define act(reading, belief)")


class ObservationPolicy(Policy):
    """Policy that computes actions from Gymnasium observations, for example a trained network."""

    def __call__(self, observation: dict[str, np.ndarray]) -> Any:
        """Return the action for an observation: an array, or the index of a frontier."""
        raise NotImplementedError(f"{type(self).__name__} must define __call__(observation)")


class _Adopted:
    """Reference to a user's object. Attributes that the object lacks are those of the other base class."""

    def __getattribute__(self, name: str) -> Any:
        if name[:2] != "__" and name not in (own := object.__getattribute__(self, "__dict__")):
            try:
                if name not in getattr(type(self), "_kept", ()):
                    return getattr(own["_value"], name)
            except AttributeError:
                pass
        return object.__getattribute__(self, name)

    def __setattr__(self, name: str, value: Any) -> None:
        if name not in vars(self) and hasattr(vars(self)["_value"], name):
            setattr(vars(self)["_value"], name, value)
        else:
            vars(self)[name] = value

    @property  # type: ignore[misc]
    def __class__(self) -> type:
        """Class of the object, for `isinstance`."""
        return type(vars(self)["_value"])

    def __reduce_ex__(self, protocol: Any) -> Any:
        base: Any = type(self).__bases__[1]
        return _rebuild, (base, vars(self))


def wrap(value: Any, base: type[Policy], **own: Any) -> Any:
    """Return a policy that refers to an object of another class, and leaves the object as it is.

    `base`: class with the attributes that the object lacks. `own`: attributes of the policy that replace those of the
    object. Without these, an object of class `base` is returned itself.
    """
    return value if isinstance(value, base) and not own else _rebuild(base, {"_value": value, **own})


def _rebuild(base: type[Policy], own: dict[str, Any]) -> Any:
    kind = type(own["_value"])
    policy: Any = object.__new__(type(kind.__name__, (_Adopted, base), {"__module__": kind.__module__}))
    vars(policy).update(own)
    return policy

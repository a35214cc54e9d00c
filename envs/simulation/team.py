"""Several robots in one world: they see each other, and bump into each other."""

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from envs.geometry import Pose2D
from envs.robots import RobotParams
from envs.worlds import World

from .kinematic import KinematicSimulator
from .simulator import Reading, TrueState, Twist

TOUCH = 1e-4
"""Gap up to which two footprints touch [m]."""


class TeamSimulator(Protocol):
    """Equal robots in one world; what `Simulator` says of one holds for each of them."""

    @property
    def states(self) -> list[TrueState]:
        """The truth about each robot after the last `reset` or `step`."""
        ...

    def reset(self, world: World, poses: Sequence[Pose2D], rngs: Sequence[np.random.Generator]) -> list[Reading]:
        """Put the robots at rest at poses in the world frame and return their first readings.

        Each robot draws its noise from a generator of its own, so that it does not depend on the others'.
        """
        ...

    def step(self, commands: Sequence[Twist]) -> list[Reading]:
        """Drive each robot with its command for one control period; return what they sense at its end."""
        ...

    def close(self) -> None:
        """Release what the simulator holds. Closing twice does no harm."""
        ...


def make_team_simulator(physics: str, robot: RobotParams, control_period: float, num_robots: int) -> TeamSimulator:
    """Return equal robots in one world under the named physics; see `make_simulator`.

    Raises:
        ValueError: the physics is unknown, or the control period is not positive.
        ImportError: bullet is asked for where PyBullet is not installed.
    """
    if physics == "kinematic":
        return KinematicTeam(robot, control_period, num_robots)
    if physics == "bullet":
        from .bullet import BulletTeam

        return BulletTeam(robot, control_period, num_robots)
    raise ValueError(f"unknown physics {physics!r}; choose bullet or kinematic")


class KinematicTeam:
    """Robots under kinematic physics. Each is a circle to the others, for their bodies and for their lidars.

    Within a period they move one after the other, past mates that stand where they are by then. So no two of them ever
    overlap, and nobody is pushed around.
    """

    def __init__(self, robot: RobotParams, control_period: float, num_robots: int) -> None:
        self._radius = robot.radius
        self._members = [KinematicSimulator(robot, control_period) for _ in range(num_robots)]

    @property
    def states(self) -> list[TrueState]:
        """The truth about each robot."""
        return [member.state for member in self._members]

    def reset(self, world: World, poses: Sequence[Pose2D], rngs: Sequence[np.random.Generator]) -> list[Reading]:
        """Put the robots at rest and return their first readings; see `TeamSimulator`.

        Raises:
            ValueError: a robot does not fit where it shall start.
        """
        check_starts(poses, self._radius)
        for member, pose, rng in zip(self._members, poses, rngs, strict=True):
            member.place(world, pose, rng)
        return [member.read(False, self._mates(k)) for k, member in enumerate(self._members)]

    def step(self, commands: Sequence[Twist]) -> list[Reading]:
        """Drive for one control period; see `TeamSimulator`.

        Raises:
            ValueError: a command holds NaN or infinity.
            RuntimeError: there was no reset.
        """
        bumped = np.zeros(len(self._members), dtype=np.bool_)
        for k, (member, command) in enumerate(zip(self._members, commands, strict=True)):
            touched, hits = member.move(command, self._mates(k))
            # Who is run into feels it as well.
            bumped |= np.insert(hits, k, touched)
        return [member.read(bool(bumped[k]), self._mates(k)) for k, member in enumerate(self._members)]

    def close(self) -> None:
        """Release what the simulator holds: nothing."""

    def _mates(self, index: int) -> np.ndarray:
        """Return the others as circles, shape (n - 1, 3) [m]."""
        return mates_as_circles([member.state.pose for member in self._members], index, self._radius)


def mates_as_circles(poses: Sequence[Pose2D], index: int, radius: float) -> np.ndarray:
    """Return all robots but one as circles (x, y, radius): shape (n - 1, 3), float64 [m]."""
    circles = [(pose.x, pose.y, radius) for k, pose in enumerate(poses) if k != index]
    return np.array(circles, dtype=np.float64).reshape(-1, 3)


def touching_pairs(poses: Sequence[Pose2D], radius: float) -> list[tuple[int, int]]:
    """Return the pairs of robots, of equal radius [m], whose footprints touch."""
    pairs = [(a, b) for b in range(len(poses)) for a in range(b)]
    return [(a, b) for a, b in pairs if math.dist(poses[a][:2], poses[b][:2]) <= 2.0 * radius + TOUCH]


def check_starts(poses: Sequence[Pose2D], radius: float) -> None:
    """Refuse robots that start in each other.

    Raises:
        ValueError: two footprints of `radius` [m] overlap.
    """
    for a, b in touching_pairs(poses, radius):
        raise ValueError(
            f"robots {a} and {b} start {math.dist(poses[a][:2], poses[b][:2]):.3f} m apart, "
            f"but each has a footprint of {radius:.3f} m"
        )

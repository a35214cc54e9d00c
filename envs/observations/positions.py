"""Where goals, the start, teammates and the route are, and how uncertain the pose is, by the robot's own estimate."""

import math
from typing import Any

import numpy as np
from gymnasium import spaces
from numba import njit

from lidarnaut.envs.arguments import is_whole
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.geometry.pose import distance
from lidarnaut.envs.robot import Robot
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import records as at
from lidarnaut.envs.task import RowPart

GOAL_RANGE = 32.0
"""Distance to the goal, or to the start, that is shown as 1 [m]."""
NEAR_RANGE = 10.0
"""Distance to the goal that `NearGoal` shows as 1 [m]."""
GOAL_MEMORY = "goal"
"""Memory of rows that begins with the goal, map frame [m]; see `Rows.memory`."""
PEERS_RANGE = 16.0
"""Distance along either axis at which the position of a teammate saturates [m]: half of what `map_far` shows."""
PEOPLE_RANGES = np.array([8.0, 8.0, 2.5, 2.5, 1.0])
"""Positions, velocities and radii at which those of people saturate [m, m/s, m]."""
ROUTE_RANGE = 5.0
"""Distance along either axis at which a point of the route saturates [m]."""
ROUTE_POINTS = 0.4 * np.arange(10)
"""How far ahead the points of the route are that are shown [m]."""


class Goal:
    """Where the goal is, in five numbers.

    Distance over 32 m (at most 1), cosine and sine of the bearing, cosine and sine of the turn to the goal's heading.
    """

    def __init__(self, task: Any) -> None:
        """Take the task, whose `goal` is the goal of the moment, map frame."""
        self._task = task

    def space(self, robot: RobotParams) -> spaces.Box:
        """Return `Box(-1, 1, (5,), float32)`."""
        return spaces.Box(-1.0, 1.0, (5,), np.float32)

    def write(self, robot: Robot, out: np.ndarray) -> None:
        """Write the goal to `out`."""
        ahead = robot.belief.pose.between(self._task.goal)
        _write_point(ahead, out[:3])
        out[3], out[4] = math.cos(ahead.theta), math.sin(ahead.theta)


@njit(cache=True, error_model="numpy")
def write_goals(rows, goals, tells_distance, active, out):
    """Write what `NearGoal` shows of active rows to `out`, shape (n, 4) or (n, 2), float32."""
    for k in range(rows.shape[0]):
        if active[k]:
            row = rows[k]
            dx, dy = goals[k, 0] - row[at.POSE], goals[k, 1] - row[at.POSE + 1]
            away, bearing = distance(dx, dy), math.atan2(dy, dx) - row[at.POSE + 2]
            if tells_distance:
                out[k, 0], out[k, 3] = min(away / NEAR_RANGE, 1.0), 1.0 / (1.0 + away)
            out[k, tells_distance], out[k, tells_distance + 1] = math.cos(bearing), math.sin(bearing)


class NearGoal(RowPart):
    """Where a goal is, near ones finely: distance over 10 m, cosine and sine of the bearing, 1 m / (1 m + distance)."""

    _memory = (GOAL_MEMORY,)

    def __init__(self, tells_distance: bool = True) -> None:
        """Choose whether the distance is told, or cosine and sine of the bearing alone."""
        self._tells_distance = int(tells_distance)

    def space(self, robot: RobotParams) -> spaces.Box:
        """Return `Box(-1, 1, (4,), float32)`, or of shape (2,)."""
        return spaces.Box(-1.0, 1.0, (2 + 2 * self._tells_distance,), np.float32)

    def write_rows(self, batch: Any, out: np.ndarray) -> None:
        """Write the goals of many robots; see `RowPart`."""
        write_goals(batch.numbers, batch.memory[GOAL_MEMORY], self._tells_distance, batch.active, out)


class Home:
    """Where the robot started, in four numbers.

    1 once the robot is to return and 0 before; distance over 32 m (at most 1), cosine and sine of the bearing.
    """

    def __init__(self, task: Any) -> None:
        """Take the task, whose `is_returning` tells whether the robot is to return."""
        self._task = task

    def space(self, robot: RobotParams) -> spaces.Box:
        """Return `Box(-1, 1, (4,), float32)`."""
        return spaces.Box(-1.0, 1.0, (4,), np.float32)

    def write(self, robot: Robot, out: np.ndarray) -> None:
        """Write where home is to `out`."""
        out[0] = self._task.is_returning
        _write_point(robot.belief.pose.inverse(), out[1:])  # the map frame is the start


def _write_point(ahead: Pose2D, out: np.ndarray) -> None:
    """Write distance and bearing of a position in the robot's frame."""
    bearing = math.atan2(ahead.y, ahead.x)
    out[0] = min(math.hypot(ahead.x, ahead.y) / GOAL_RANGE, 1.0)
    out[1], out[2] = math.cos(bearing), math.sin(bearing)


class PoseUncertainty:
    """The uncertainty of the pose estimate, in three numbers.

    Standard deviation of the position over 1 m and of the heading over pi (at most 1), and 1 if the estimator is lost.
    """

    def space(self, robot: RobotParams) -> spaces.Box:
        """Return `Box(0, 1, (3,), float32)`."""
        return spaces.Box(0.0, 1.0, (3,), np.float32)

    def write(self, robot: Robot, out: np.ndarray) -> None:
        """Write the pose's uncertainty to `out`."""
        x, y, theta = np.sqrt(np.diag(robot.belief.covariance)).tolist()
        out[:] = min(math.hypot(x, y), 1.0), min(theta / math.pi, 1.0), robot.belief.is_lost


class Peers:
    """Estimated poses of the others of a team: forward and to the left over 16 m, cosine and sine of the heading."""

    def __init__(self, num_peers: int) -> None:
        """Take how many others there are."""
        self._num_peers = num_peers

    def space(self, robot: RobotParams) -> spaces.Box:
        """Return `Box(-1, 1, (4 * num_peers,), float32)`: in one row, since three axes are taken for an image."""
        return spaces.Box(-1.0, 1.0, (4 * self._num_peers,), np.float32)

    def write(self, robot: Robot, out: np.ndarray) -> None:
        """Write the others' poses to `out`, in the order of their indices."""
        for row, peer in zip(out.reshape(-1, 4), robot.peers, strict=True):
            x, y, theta = robot.belief.pose.between(peer.belief.pose)
            row[0] = min(max(x / PEERS_RANGE, -1.0), 1.0)
            row[1] = min(max(y / PEERS_RANGE, -1.0), 1.0)
            row[2:] = math.cos(theta), math.sin(theta)


class Tracks:
    """People that the robot tracks by its scans, the nearest first, five numbers for each, zeros where there are fewer.

    Position forward and to the left over 8 m, velocity over the ground along the same axes over 2.5 m/s, radius over
    1 m; see `lidarnaut.envs.estimation.tracking`. Environments let robots track people where this is observed.
    """

    def __init__(self, num_people: int = 8) -> None:
        """Choose how many people are shown at most."""
        if not (is_whole(num_people) and num_people > 0):
            raise ValueError(f"num_people of tracks must be whole and positive, got {num_people!r}")
        self._num_people = num_people

    def space(self, robot: RobotParams) -> spaces.Box:
        """Return `Box(-1, 1, (5 * num_people,), float32)`."""
        return spaces.Box(-1.0, 1.0, (5 * self._num_people,), np.float32)

    def write(self, robot: Robot, out: np.ndarray) -> None:
        """Write the people to `out`."""
        people = robot.belief.people
        nearest = np.argsort(np.hypot(people[:, 0], people[:, 1]), kind="stable")[: self._num_people]
        out[:] = 0.0
        out[: 5 * len(nearest)] = np.clip(people[nearest] / PEOPLE_RANGES, -1.0, 1.0).ravel()


class RouteAhead:
    """Points of the route 0, 0.4, ... 3.6 m ahead, as (forward, left) of the estimated pose, over 5 m."""

    def __init__(self, task: Any) -> None:
        """Take the task, whose `route_progress` tells where on the route the robot is."""
        self._task = task

    def space(self, robot: RobotParams) -> spaces.Box:
        """Return `Box(-1, 1, (10, 2), float32)`."""
        return spaces.Box(-1.0, 1.0, (len(ROUTE_POINTS), 2), np.float32)

    def write(self, robot: Robot, out: np.ndarray) -> None:
        """Write the points to `out`."""
        ahead = robot.belief.pose.inverse().transform(self._task.route_progress.ahead(ROUTE_POINTS))
        np.clip(ahead / ROUTE_RANGE, -1.0, 1.0, out=out, casting="same_kind")

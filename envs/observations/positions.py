"""Observations of goal, start, teammates, people and route."""

import math
from typing import Any

import numpy as np
from gymnasium import spaces

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.geometry.pose import distance
from lidarnaut.envs.robot import Robot
from lidarnaut.envs.robot_rows import RobotRows
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.task import BoxPart, RowPart

GOAL_RANGE = 32.0
"""Distance to goal or start that is normalized to 1 [m]."""
NEAR_RANGE = 10.0
"""Distance to the goal that the observation `NearGoal` normalizes to 1 [m]."""
GOAL_MEMORY = "goal"
"""Key of the array of task states, one row per robot, with the goal's x and y in the first columns, map frame [m]."""
PEERS_RANGE = 16.0
"""Teammate offset per axis that is normalized to 1 [m]: half the side of the map crop `map_far`."""
NUM_PEOPLE = 8
PEOPLE_RANGES = np.array([8.0, 8.0, 2.5, 2.5, 1.0])
"""Divisors of people's position, velocity and radius in the observation `Tracks` [m, m, m/s, m/s, m]."""
ROUTE_RANGE = 5.0
"""Offset of a route point per axis that is normalized to 1 [m]."""
ROUTE_POINTS = 0.4 * np.arange(10)
"""Distances along the route from the robot to observed route points [m]."""


class TaskPart(BoxPart):
    """Base class of observations that read attributes of the task."""

    def __init__(self, task: Any) -> None:
        self._task = task


class Goal(TaskPart):
    """Observation of the goal relative to the estimated pose: `Box(-1, 1, (5,), float32)`.

    Distance / 32 m (at most 1), cosine and sine of the bearing, cosine and sine of the heading difference.
    """

    size = 5

    def write(self, robot: Robot, out: np.ndarray) -> None:
        ahead = robot.belief.pose.between(self._task.goal)
        _write_point(ahead, out[:3])
        out[3], out[4] = math.cos(ahead.theta), math.sin(ahead.theta)


@njit(cache=True, error_model="numpy")
def write_goals(rows, goals, tells_distance, active, out):
    """Write the observation `NearGoal` of active robots to `out`, shape (n, 4), or (n, 2) if distances are excluded."""
    for k in range(rows.shape[0]):
        if active[k]:
            row = rows[k]
            dx, dy = goals[k, 0] - row.pose[0], goals[k, 1] - row.pose[1]
            away, bearing = distance(dx, dy), math.atan2(dy, dx) - row.pose[2]
            if tells_distance:
                out[k, 0], out[k, 3] = min(away / NEAR_RANGE, 1.0), 1.0 / (1.0 + away)
            out[k, tells_distance], out[k, tells_distance + 1] = math.cos(bearing), math.sin(bearing)


class NearGoal(RowPart):
    """Observation of the goal relative to the estimated pose, with fine resolution nearby: `Box(-1, 1, (4,), float32)`.

    Distance / 10 m (at most 1), cosine and sine of the bearing, 1 m / (1 m + distance).
    """

    def __init__(self, tells_distance: bool = True) -> None:
        """Set whether the distance to the goal is included (four features, else two)."""
        self._tells_distance = int(tells_distance)
        self.size = 2 + 2 * self._tells_distance

    def _write(self, rows: RobotRows, out: np.ndarray) -> None:
        write_goals(rows.numbers, rows.memory[GOAL_MEMORY], self._tells_distance, rows.active, out)


class Home(TaskPart):
    """Observation of the robot's start relative to the estimated pose: `Box(-1, 1, (4,), float32)`.

    1 while the robot has to return, else 0; distance / 32 m (at most 1); cosine and sine of the bearing.
    """

    size = 4

    def write(self, robot: Robot, out: np.ndarray) -> None:
        out[0] = self._task.is_returning
        _write_point(robot.belief.pose.inverse(), out[1:])  # the start is the origin of the map frame


def _write_point(ahead: Pose2D, out: np.ndarray) -> None:
    bearing = math.atan2(ahead.y, ahead.x)
    out[0] = min(math.hypot(ahead.x, ahead.y) / GOAL_RANGE, 1.0)
    out[1], out[2] = math.cos(bearing), math.sin(bearing)


class PoseUncertainty(BoxPart):
    """Observation of the uncertainty of the pose estimate: `Box(0, 1, (3,), float32)`.

    Standard deviations of position / 1 m and heading / pi (at most 1), and 1 if the robot is lost, else 0.
    """

    low, size = 0.0, 3

    def write(self, robot: Robot, out: np.ndarray) -> None:
        x, y, theta = np.sqrt(np.diag(robot.belief.covariance)).tolist()
        out[:] = min(math.hypot(x, y), 1.0), min(theta / math.pi, 1.0), robot.belief.is_lost


class Battery(TaskPart):
    """Observation of the battery: `Box(0, 1, (2,), float32)`. Charge (1 is full), and 1 while charging, else 0."""

    low, size = 0.0, 2

    def write(self, robot: Robot, out: np.ndarray) -> None:
        out[:] = self._task.charge, self._task.is_docked


class Peers(BoxPart):
    """Observation of teammates relative to the robot: `Box(-1, 1, (4 * num_peers,), float32)`.

    Per teammate: offsets forward and left / 16 m, cosine and sine of the relative heading.
    """

    def __init__(self, num_peers: int) -> None:
        self.size = 4 * num_peers

    def write(self, robot: Robot, out: np.ndarray) -> None:
        for row, peer in zip(out.reshape(-1, 4), robot.peers, strict=True):
            x, y, theta = robot.belief.pose.between(peer.belief.pose)
            row[0] = min(max(x / PEERS_RANGE, -1.0), 1.0)
            row[1] = min(max(y / PEERS_RANGE, -1.0), 1.0)
            row[2:] = math.cos(theta), math.sin(theta)


class Tracks(BoxPart):
    """Observation of up to eight people tracked in scans, nearest first: `Box(-1, 1, (40,), float32)`, zero-padded.

    Position forward and left / 8 m, ground velocity along these axes / (2.5 m/s), radius / 1 m.
    """

    size = 5 * NUM_PEOPLE

    def write(self, robot: Robot, out: np.ndarray) -> None:
        people = robot.belief.people
        nearest = np.argsort(np.hypot(people[:, 0], people[:, 1]), kind="stable")[:NUM_PEOPLE]
        out[:] = 0.0
        out[: 5 * len(nearest)] = np.clip(people[nearest] / PEOPLE_RANGES, -1.0, 1.0).ravel()


class RouteAhead(TaskPart):
    """Observation of route points ahead: `Box(-1, 1, (10, 2), float32)`.

    Offsets (forward, left) / 5 m of points 0, 0.4, ... 3.6 m ahead, from the estimated pose.
    """

    def space(self, robot: RobotParams) -> spaces.Box:
        return spaces.Box(-1.0, 1.0, (len(ROUTE_POINTS), 2), np.float32)

    def write(self, robot: Robot, out: np.ndarray) -> None:
        ahead = robot.belief.pose.inverse().transform(self._task.route_progress.ahead(ROUTE_POINTS))
        np.clip(ahead / ROUTE_RANGE, -1.0, 1.0, out=out, casting="same_kind")

"""Routes, progress along a route, and pure pursuit."""

import math
from dataclasses import dataclass

import numpy as np

from lidarnaut.envs.geometry import Pose2D, wrap_angle
from lidarnaut.envs.geometry.lines import lengths_along, points_at
from lidarnaut.envs.simulation import Twist

END = 0.1
"""Remaining length below which a route is completed [m]."""
SPACING = 0.05
"""Distance between neighbouring points of a route [m]."""
WINDOW = 40
"""Number of route points searched for the point nearest to the robot, beginning at the last nearest point."""


@dataclass(frozen=True, slots=True, eq=False)
class Route:
    """Path of equally spaced points with headings and arc lengths."""

    points: np.ndarray
    """Points of the route, shape (n, 2), float64 [m]."""
    headings: np.ndarray
    """Direction of the tangent at each point, shape (n,), float64 [rad]."""
    along: np.ndarray
    """Arc length from the start to each point, shape (n,), float64 [m]."""

    @classmethod
    def of(cls, corners: np.ndarray) -> "Route":
        """Return the route along a polyline, shape (n, 2), n > 1 [m]; ValueError if not finite or below `SPACING`."""
        corners = np.asarray(corners, dtype=np.float64)
        if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 2 or not np.isfinite(corners).all():
            raise ValueError(f"a path must be finite points of shape (n, 2), n > 1, got {corners.tolist()!r:.200}")
        at = lengths_along(corners)
        if at[-1] < SPACING:
            raise ValueError(f"a path must be at least {SPACING} m long, got {at[-1]:.3g} m")
        along = np.linspace(0.0, at[-1], math.ceil(at[-1] / SPACING) + 1)
        points = points_at(corners, at, along)
        return cls(points, directions(points), along)

    @property
    def length(self) -> float:
        """Length of the route [m]."""
        return float(self.along[-1])

    @property
    def start(self) -> Pose2D:
        return Pose2D(float(self.points[0, 0]), float(self.points[0, 1]), float(self.headings[0]))

    def at(self, along: float) -> Pose2D:
        """Return the pose on the route at an arc length [m], at most at its ends."""
        k = min(max(int(np.searchsorted(self.along, along)) - 1, 0), len(self.along) - 2)
        share = min(max((along - self.along[k]) / (self.along[k + 1] - self.along[k]), 0.0), 1.0)
        x, y = ((1.0 - share) * self.points[k] + share * self.points[k + 1]).tolist()
        return Pose2D(x, y, wrap_angle(self.headings[k] + share * wrap_angle(self.headings[k + 1] - self.headings[k])))

    def seen_from(self, frame: Pose2D) -> "Route":
        """Return the route in another frame, given as a pose in the current frame."""
        headings = np.array([wrap_angle(heading - frame.theta) for heading in self.headings])
        return Route(frame.inverse().transform(self.points), headings, self.along)


def directions(points: np.ndarray) -> np.ndarray:
    """Return the direction of the tangent at each of n > 1 points, shape (n, 2): shape (n,), float64 [rad]."""
    steps = np.gradient(points, axis=0)
    return np.arctan2(steps[:, 1], steps[:, 0])


def rectangle(start: Pose2D) -> np.ndarray:
    """Return the rectangular route of Nguyen et al. (2021), 78 m long, counter-clockwise, shape (n, 2), float64 [m].

    Corners are arcs of 1 m radius. `start`: pose at the beginning of the first long side.
    """
    length, side = 78.0, 24.0
    other = 0.5 * (length + 8.0 - 2.0 * math.pi) - side
    angles = np.linspace(-0.5 * math.pi, 0.0, math.ceil(0.5 * math.pi / SPACING) + 1)
    corner = np.column_stack([np.cos(angles), np.sin(angles) + 1.0])
    pieces = [np.zeros((1, 2))]
    pose = Pose2D(0.0, 0.0, 0.0)
    for straight in (side - 2.0, other - 2.0) * 2:
        pose = pose.compose(Pose2D(straight, 0.0, 0.0))
        pieces.append(pose.transform(corner))
        pose = pose.compose(Pose2D(1.0, 1.0, 0.5 * math.pi))
    return start.transform(np.concatenate(pieces))


class Progress:
    """Position of a robot along a route; never moves backwards or jumps at crossings."""

    def __init__(self, route: Route) -> None:
        self.route = route
        self.index = 0
        """Index of the route point nearest to the robot."""

    def update(self, pose: Pose2D) -> tuple[float, float]:
        """Move to the route point nearest to `pose`; return its arc length and the offset of `pose` to the left [m]."""
        route = self.route
        ahead = route.points[self.index : self.index + WINDOW] - pose[:2]
        self.index += int(np.argmin(np.einsum("ij,ij->i", ahead, ahead)))
        dx, dy = pose[:2] - route.points[self.index]
        c, s = math.cos(route.headings[self.index]), math.sin(route.headings[self.index])
        return float(route.along[self.index]), float(c * dy - s * dx)

    def ahead(self, distances: np.ndarray) -> np.ndarray:
        """Return the route points at `distances` [m] ahead of the robot, along the route: shape (n, 2).

        Points beyond the end are the last point.
        """
        target = self.route.along[self.index] + distances
        return points_at(self.route.points, self.route.along, target)


def steer(progress: Progress, pose: Pose2D, speed: float, lookahead: float) -> Twist:
    """Return the pure pursuit command (forward speed, yaw rate) for a speed [m/s] and a lookahead distance [m].

    `pose`: base pose, frame of the route; `progress`: position along the route, updated with this pose.
    """
    x, y = pose.inverse().transform(progress.ahead(np.array([lookahead])))[0]
    return Twist(speed, speed * 2.0 * y / max(x * x + y * y, 1e-6))

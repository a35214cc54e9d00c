"""Routes to follow: points with their headings, and where along them a robot is."""

import math
from dataclasses import dataclass

import numpy as np

from lidarnaut.envs.geometry import Pose2D, wrap_angle
from lidarnaut.envs.geometry.lines import lengths_along, points_at
from lidarnaut.envs.simulation import Twist

END = 0.1
"""This near to its end a route counts as driven [m]."""
SPACING = 0.05
"""Distance between neighbouring points of a route [m]."""
WINDOW = 40
"""Points ahead among which the nearest is looked for: a route that crosses or closes itself is driven in order."""


@dataclass(frozen=True, slots=True, eq=False)
class Route:
    """A path to drive, from its first to its last point."""

    points: np.ndarray
    """Shape (n, 2), float64 [m]."""
    headings: np.ndarray
    """Shape (n,), float64, direction of the route at each point [rad]."""
    along: np.ndarray
    """Shape (n,), float64, length of the route from the start to each point [m]."""

    @classmethod
    def of(cls, corners: np.ndarray) -> "Route":
        """Return the route along a polyline, shape (n, 2), n > 1 [m].

        Raises:
            ValueError: the shape is another, or something is not finite or of no length.
        """
        corners = np.asarray(corners, dtype=np.float64)
        if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 2 or not np.isfinite(corners).all():
            raise ValueError(f"a path must be finite points of shape (n, 2), n > 1, got {corners.tolist()!r:.200}")
        at = lengths_along(corners)
        if at[-1] < SPACING:
            raise ValueError(f"a path must be at least {SPACING} m long, got {at[-1]:.3g} m")
        along = np.linspace(0.0, at[-1], math.ceil(at[-1] / SPACING) + 1)
        points = points_at(corners, at, along)
        steps = np.diff(points, axis=0)
        headings = np.arctan2(steps[:, 1], steps[:, 0])
        return cls(points, np.append(headings, headings[-1]), along)

    @property
    def length(self) -> float:
        """Length of the route [m]."""
        return float(self.along[-1])

    @property
    def start(self) -> Pose2D:
        """Pose at the beginning."""
        return Pose2D(float(self.points[0, 0]), float(self.points[0, 1]), float(self.headings[0]))

    def seen_from(self, frame: Pose2D) -> "Route":
        """Return the same route in another frame, given in the frame of this one."""
        headings = np.array([wrap_angle(heading - frame.theta) for heading in self.headings])
        return Route(frame.inverse().transform(self.points), headings, self.along)


def rectangle(start: Pose2D) -> np.ndarray:
    """Return the route of Nguyen et al. (2021): 78 m around a rectangle, counter-clockwise from the end of a corner.

    Its corners are arcs of 1 m: a robot with two driven wheels does not take a sharp corner at speed, as the paper's
    mecanum robot may. `start` is where the first long side begins, 24 m long with its corners. Shape (n, 2), float64
    [m], points `SPACING` apart in the corners; the last equals the first.
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
    """Where along a route a robot is; never decreases, and never jumps to where the route crosses itself."""

    def __init__(self, route: Route) -> None:
        """Begin at the start of the route."""
        self.route = route
        self.index = 0
        """Of the nearest point, looking ahead from the last one."""

    def update(self, pose: Pose2D) -> tuple[float, float]:
        """Return how far along the route a pose is, and how far to the left of it [m]."""
        route = self.route
        ahead = route.points[self.index : self.index + WINDOW] - pose[:2]
        self.index += int(np.argmin(np.einsum("ij,ij->i", ahead, ahead)))
        dx, dy = pose[:2] - route.points[self.index]
        c, s = math.cos(route.headings[self.index]), math.sin(route.headings[self.index])
        return float(route.along[self.index]), float(c * dy - s * dx)

    def ahead(self, distances: np.ndarray) -> np.ndarray:
        """Return the points of the route that lie so far ahead, the last one where it ends: shape (n, 2) [m]."""
        target = self.route.along[self.index] + distances
        return points_at(self.route.points, self.route.along, target)


def steer(progress: Progress, pose: Pose2D, speed: float, lookahead: float) -> Twist:
    """Return the twist with a speed [m/s] that leads to the route `lookahead` metres on, by pure pursuit.

    `progress` must be up to date with the pose of the robot, in the frame of the route.
    """
    x, y = pose.inverse().transform(progress.ahead(np.array([lookahead])))[0]
    return Twist(speed, speed * 2.0 * y / max(x * x + y * y, 1e-6))

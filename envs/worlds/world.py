"""Worlds as data: walls, movers, spawns."""

from bisect import bisect_right
from dataclasses import dataclass, field, replace

import numpy as np

from envs.geometry import Pose2D
from envs.geometry.lines import lengths_along

MAX_COORDINATE = 1e7
"""Numbers of a world beyond this are no positions or sizes [m]; coordinates of maps of the earth lie below."""


@dataclass(frozen=True, slots=True, eq=False)
class Mover:
    """A vertical cylinder that walks around a closed polyline at constant speed."""

    radius: float
    """Radius of the cylinder [m]."""
    waypoints: np.ndarray
    """Shape (k, 2), float64, corners of the closed polyline [m]."""
    speed: float
    """Speed along the polyline [m/s]."""

    _corners: list[list[float]] = field(init=False, repr=False)
    """The waypoints as (x, y), the first again at the end [m]."""
    _along: list[float] = field(init=False, repr=False)
    """Length of the polyline up to each of them [m]."""

    def __post_init__(self) -> None:
        corners = np.vstack([self.waypoints, self.waypoints[:1]])
        object.__setattr__(self, "_corners", corners.tolist())
        object.__setattr__(self, "_along", lengths_along(corners).tolist())

    def position(self, time: float) -> tuple[float, float]:
        """Return the centre (x, y) [m] at `time` [s]; the first waypoint at time 0."""
        # In plain Python: this runs in every step, and NumPy takes ten times as long for one point.
        s = (time * self.speed) % self._along[-1]
        k = bisect_right(self._along, s) - 1
        (x0, y0), (x1, y1) = self._corners[k], self._corners[k + 1]
        length = self._along[k + 1] - self._along[k]
        ahead = s - self._along[k]
        return (x1 - x0) / length * ahead + x0, (y1 - y0) / length * ahead + y0


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """A horizontal section through an environment at the height of the robots' lidars, extruded to `height`."""

    name: str
    """What users call it."""
    segments: np.ndarray
    """Shape (n, 4), float64: walls and outlines of solid bodies as (x0, y0, x1, y1) [m]."""
    circles: np.ndarray
    """Shape (m, 3), float64: vertical cylinders as (x, y, radius) [m]."""
    spawns: tuple[Pose2D, ...]
    """Poses where a robot can start; the first is the usual one. All lie in one connected free area."""
    bounds: tuple[float, float, float, float]
    """(x_min, y_min, x_max, y_max) of everything static [m]."""
    movers: tuple[Mover, ...] = ()
    """Bodies that move."""
    height: float = 1.0
    """Height of walls and bodies in the physics engine [m]."""
    source: str = ""
    """Where the geometry comes from."""
    licence: str = ""
    """Licence of the source, as its authors state it."""
    notes: str = ""
    """What was chosen, closed or left out when the source became this world."""

    def scaled(self, factor: float) -> "World":
        """Return the world enlarged by a factor in the plane, with movers that take as long for a round."""
        return replace(
            self,
            segments=factor * self.segments,
            circles=factor * self.circles,
            spawns=tuple(Pose2D(factor * x, factor * y, theta) for x, y, theta in self.spawns),
            bounds=tuple(factor * side for side in self.bounds),  # type: ignore[arg-type]
            movers=tuple(Mover(factor * m.radius, factor * m.waypoints, factor * m.speed) for m in self.movers),
        )

    def circles_at(self, time: float) -> np.ndarray:
        """Return the static circles followed by the movers at `time` [s]: shape (m + movers, 3), float64 [m]."""
        if not self.movers:
            return self.circles
        moving = np.array([(*mover.position(time), mover.radius) for mover in self.movers])
        return np.vstack([self.circles, moving])

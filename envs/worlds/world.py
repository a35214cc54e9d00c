"""Worlds as data: walls, people on fixed routes, spawns."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import wraps
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

import numpy as np

from lidarnaut.envs.geometry import OccupancyGrid, Pose2D

Result = TypeVar("Result")
MAX_COORDINATE = 1e7
"""Numbers of a world beyond this are no positions or sizes [m]; coordinates of maps of the earth lie below."""


@dataclass(frozen=True, slots=True, eq=False)
class FixedRoute:
    """A person who walks around a closed polyline at constant speed, and waits where a robot is in the way."""

    radius: float
    """Radius of the person [m]."""
    waypoints: np.ndarray
    """Shape (k, 2), float64, corners of the closed polyline [m]; the person starts at the first one."""
    speed: float
    """Speed along the polyline [m/s]."""


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
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
    people: tuple[FixedRoute, ...] = ()
    """People on fixed routes, who belong to the world."""
    goals: tuple[Pose2D, ...] = ()
    """Usual goal of a robot that starts at each of the spawns; empty where the world has none."""
    optimal_length: float | None = None
    """Length of the path from the first spawn to its goal that a benchmark measures robots by [m]."""
    height: float = 1.0
    """Height of walls and bodies in the physics engine [m]."""
    source: str = ""
    """Where the geometry comes from."""
    licence: str = ""
    """Licence of the source, as its authors state it."""
    notes: str = ""
    """What was chosen, closed or left out when the source became this world."""
    map: OccupancyGrid | None = None
    """Map that the world was made of; None for others."""

    def scaled(self, factor: float) -> "World":
        """Return the world enlarged by a factor in the plane, with people that take as long for a round."""
        return replace(
            self,
            segments=factor * self.segments,
            circles=factor * self.circles,
            spawns=tuple(Pose2D(factor * x, factor * y, theta) for x, y, theta in self.spawns),
            goals=tuple(Pose2D(factor * x, factor * y, theta) for x, y, theta in self.goals),
            optimal_length=None if self.optimal_length is None else factor * self.optimal_length,
            bounds=tuple(factor * side for side in self.bounds),  # type: ignore[arg-type]
            people=tuple(FixedRoute(factor * p.radius, factor * p.waypoints, factor * p.speed) for p in self.people),
            map=None,
        )

    @property
    def circles_at_start(self) -> np.ndarray:
        """The circles, and after them the people on fixed routes at time 0: shape (m + people, 3), float64 [m]."""
        if not self.people:
            return self.circles
        return np.vstack([self.circles, [(*person.waypoints[0], person.radius) for person in self.people]])


def kept_with_world(function: Callable[..., Result]) -> Callable[..., Result]:
    """Keep what a function makes of a world or its area, the first argument, and of hashable others, while it lives."""
    kept: WeakKeyDictionary[World, dict[tuple, Result]] = WeakKeyDictionary()

    @wraps(function)
    def find(world: World, *others: Any) -> Result:
        found = kept.setdefault(world, {})
        if others not in found:
            found[others] = function(world, *others)
        return found[others]

    return find


def box(x: float, y: float, length: float, width: float, yaw: float = 0.0) -> np.ndarray:
    """Return the corners of a rectangle around (x, y), counter-clockwise, shape (4, 2) [m]."""
    corners = np.array([[-length, -width], [length, -width], [length, width], [-length, width]]) / 2
    return Pose2D(x, y, yaw).transform(corners)


def edges(points: np.ndarray) -> np.ndarray:
    """Return the segments from each of n points to the next, and from the last to the first: shape (n, 4) [m]."""
    return np.hstack([points, np.roll(points, -1, axis=0)])

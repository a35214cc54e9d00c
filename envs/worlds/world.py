import reprlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import wraps
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

import numpy as np

from lidarnaut.envs.geometry import OccupancyGrid, Pose2D

Result = TypeVar("Result")
MAX_COORDINATE = 1e7
"""Maximum absolute coordinate or size in a world [m]."""
MAX_RADIUS, MAX_SPEED = 10.0, 100.0
"""Maximum radius [m] and speed [m/s] of a person on a fixed route."""
MIN_ROUTE_SIZE = 1e-4
"""Minimum extent of a fixed route along x or y [m]. On a shorter one, a step would pass too many waypoints."""


def read_route(waypoints: Any) -> np.ndarray:
    """Return the waypoints of a person as a new array, shape (k, 2), float64 [m]; ValueError if they are no route."""
    points = np.array(waypoints, dtype=np.float64)
    is_valid = points.shape[1:] == (2,) and len(points) > 0 and np.abs(points).max() <= MAX_COORDINATE
    if not (is_valid and np.ptp(points, axis=0).max() >= MIN_ROUTE_SIZE):
        allowed = f"different points [x, y], at least {MIN_ROUTE_SIZE:g} m apart and at most {MAX_COORDINATE:g} m away"
        raise ValueError(f"a route needs two {allowed}, got {reprlib.repr(points.tolist())}")
    return points


@dataclass(frozen=True, slots=True, eq=False)
class FixedRoute:
    """Person walking on a closed polyline at constant speed, waiting if a robot is in the way.

    ValueError if the polyline has no length, or a number is out of range.
    """

    radius: float
    waypoints: np.ndarray
    """Corners of the closed polyline, starting position first: shape (k, 2), float64 [m]."""
    speed: float
    """Speed along the polyline [m/s]."""

    def __post_init__(self) -> None:
        for name, highest in (("radius", MAX_RADIUS), ("speed", MAX_SPEED)):
            if not 0.0 < (value := getattr(self, name)) <= highest:
                raise ValueError(f"{name} of a person must be positive and at most {highest:g}, got {value!r}")
        object.__setattr__(self, "waypoints", read_route(self.waypoints))


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class World:
    """Static geometry, start poses, goals and people of a simulated world.

    Walls and bodies are a horizontal section at lidar height, extruded to `height`. ValueError if coordinates are not
    finite or too large.
    """

    name: str
    segments: np.ndarray
    """Walls and outlines of solid bodies as (x0, y0, x1, y1): shape (n, 4), float64 [m]."""
    circles: np.ndarray
    """Vertical cylinders as (x, y, radius): shape (m, 3), float64 [m]."""
    spawns: tuple[Pose2D, ...]
    """Start poses (x, y, theta) in one connected free area; the first is the default."""
    bounds: tuple[float, float, float, float]
    """Bounds (x_min, y_min, x_max, y_max) of the static geometry [m]."""
    people: tuple[FixedRoute, ...] = ()
    goals: tuple[Pose2D, ...] = ()
    """Default goal pose for each start pose, or empty."""
    docks: tuple[Pose2D, ...] = ()
    """Charging stations: centre of the front, and heading of a docked robot, which points into the station."""
    optimal_length: float | None = None
    """Reference path length from the first start pose to its goal [m]."""
    height: float = 1.0
    """Height of walls and bodies in the physics engine [m]."""
    source: str = ""
    """Source of the geometry, such as a publication."""
    licence: str = ""
    notes: str = ""
    """Changes made to the source geometry, such as closed gaps."""
    map: OccupancyGrid | None = None
    """Map that the world was built from, if any."""
    magnets: np.ndarray = field(default_factory=lambda: np.empty((0, 4)))
    """Magnetic sources (x, y, strength, decay) that disturb compasses: shape (k, 4), float64. A source adds an error of
    `strength` [rad] to headings within 1 m, and of strength / distance^decay beyond."""

    def __post_init__(self) -> None:
        for what in ("bounds", "segments", "circles", "spawns", "goals", "docks"):
            farthest = np.abs(np.asarray(getattr(self, what), dtype=np.float64)).max(initial=0.0)
            if not farthest <= MAX_COORDINATE:
                most = f"at most {MAX_COORDINATE:g} m is allowed"
                raise ValueError(f"world {self.name!r}: {what} contain {farthest:g}; {most}")
        rows = self.magnets if getattr(self.magnets, "dtype", None) == np.float64 else np.empty(0)
        if rows.shape[1:] != (4,) or not np.isfinite(rows).all() or (rows[:, 3] <= 0.0).any():
            allowed = "an array of shape (k, 4), float64, of finite x, y, strength and positive decay"
            raise ValueError(f"world {self.name!r}: magnets must be {allowed}, got {self.magnets!r}")

    def scaled(self, factor: float) -> "World":
        """Return the world scaled by `factor` in x and y, including the speeds of people."""
        return replace(
            self,
            segments=factor * self.segments,
            circles=factor * self.circles,
            magnets=np.column_stack([self.magnets[:, :2] * factor, self.magnets[:, 2:]]),
            spawns=tuple(Pose2D(factor * x, factor * y, theta) for x, y, theta in self.spawns),
            goals=tuple(Pose2D(factor * x, factor * y, theta) for x, y, theta in self.goals),
            docks=tuple(Pose2D(factor * x, factor * y, theta) for x, y, theta in self.docks),
            optimal_length=None if self.optimal_length is None else factor * self.optimal_length,
            bounds=tuple(factor * side for side in self.bounds),  # type: ignore[arg-type]
            people=tuple(FixedRoute(factor * p.radius, factor * p.waypoints, factor * p.speed) for p in self.people),
            map=None,
        )

    @property
    def circles_at_start(self) -> np.ndarray:
        """Cylinders and people at time 0, as (x, y, radius): shape (n, 3), float64 [m]."""
        if not self.people:
            return self.circles
        return np.vstack([self.circles, [(*person.waypoints[0], person.radius) for person in self.people]])


def kept_with_world(function: Callable[..., Result]) -> Callable[..., Result]:
    """Decorator that caches results for the lifetime of the first argument, a `World` or its raster."""
    kept: WeakKeyDictionary[World, dict[tuple, Result]] = WeakKeyDictionary()

    @wraps(function)
    def find(world: World, *others: Any) -> Result:
        found = kept.setdefault(world, {})
        if others not in found:
            found[others] = function(world, *others)
        return found[others]

    return find


def box(x: float, y: float, length: float, width: float, yaw: float = 0.0) -> np.ndarray:
    """Return the corners, counter-clockwise, of a rectangle at (x, y), rotated by `yaw` [rad]: shape (4, 2) [m]."""
    corners = np.array([[-length, -width], [length, -width], [length, width], [-length, width]]) / 2
    return Pose2D(x, y, yaw).transform(corners)


def edges(points: np.ndarray) -> np.ndarray:
    """Return the edges of a closed polygon as segments (x0, y0, x1, y1): shape (n, 4) [m]."""
    return np.hstack([points, np.roll(points, -1, axis=0)])

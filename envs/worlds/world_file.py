import math
import reprlib
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from lidarnaut.envs.geometry import Pose2D

from .raster import check_world
from .world import MAX_COORDINATE, MAX_RADIUS, MAX_SPEED, FixedRoute, World, box, edges, read_route

DIPOLE_DECAY = 3.0
"""Exponent of the decay of a magnetic dipole's field with distance."""

Number = Annotated[float, Field(ge=-MAX_COORDINATE, le=MAX_COORDINATE, allow_inf_nan=False)]
Size = Annotated[float, Field(gt=0.0, le=MAX_COORDINATE, allow_inf_nan=False)]
Rows = list[list[Number]]
Loops = list[list[list[Number]]]


def _columns(columns: str, positive: tuple[int, ...] = (), optional: int = 0) -> AfterValidator:
    """Return a validator for lists of numbers with the named columns.

    `positive`: indices of positive columns; `optional`: number of optional last columns.
    """
    names = columns.split(", ")

    def check(rows: Rows) -> Rows:
        for i, row in enumerate(rows):
            if not len(names) - optional <= len(row) <= len(names):
                may = f" ({', '.join(names[-optional:])} optional)" if optional else ""
                raise ValueError(f"row {i} must be [{columns}]{may}, got {reprlib.repr(row)}")
            for k in positive:
                if k < len(row) and row[k] <= 0:
                    raise ValueError(f"row {i}: {names[k]} must be positive, got {row[k]} in {row}")
        return rows

    return AfterValidator(check)


def _points(minimum: int) -> AfterValidator:
    """Return a validator for lists of at least `minimum` different points (x, y)."""

    def check(loops: Loops) -> Loops:
        for i, loop in enumerate(loops):
            if any(len(point) != 2 for point in loop) or len({tuple(point) for point in loop}) < minimum:
                wanted = f"a list of at least {minimum} different points [x, y]"
                raise ValueError(f"item {i} must be {wanted}, got {reprlib.repr(loop)}")
        return loops

    return AfterValidator(check)


class RouteFile(BaseModel):
    """Person on a fixed route in a world file, in metres and seconds."""

    model_config = ConfigDict(extra="forbid")

    radius: float = Field(gt=0.0, le=MAX_RADIUS, allow_inf_nan=False)
    speed: float = Field(gt=0.0, le=MAX_SPEED, allow_inf_nan=False)
    waypoints: Annotated[Rows, _columns("x, y"), AfterValidator(read_route)]


class WorldFile(BaseModel):
    """Content of a world's YAML file; lengths in metres, angles in radians."""

    model_config = ConfigDict(extra="forbid")

    source: str
    """Source of the geometry, such as a publication."""
    licence: str
    """License of the source."""
    notes: str = ""
    """Changes to the source geometry, such as closed gaps."""
    height: Size = 1.0
    """Height of walls and bodies in the physics engine."""
    spawns: Annotated[Rows, _columns("x, y, heading"), Field(min_length=1)]
    """Start poses (x, y, heading); the first is the default."""
    goals: Annotated[Rows, _columns("x, y, heading")] = []
    """Default goal for each start pose."""
    docks: Annotated[Rows, _columns("x, y, heading")] = []
    """Charging stations: centre of the front, and heading of a docked robot."""
    boxes: Annotated[Rows, _columns("x, y, length, width, yaw", positive=(2, 3), optional=1)] = []
    """Solid rectangles: centre, length, width and yaw."""
    polygons: Annotated[Loops, _points(3)] = []
    """Solid polygons, each a list of corners."""
    polylines: Annotated[Loops, _points(2)] = []
    """Thin walls along lists of points. The last point of a closed line repeats the first."""
    segments: Annotated[Rows, _columns("x0, y0, x1, y1, thickness", positive=(4,), optional=1)] = []
    """Straight thin walls, or solid rectangles with a given thickness."""
    cylinders: Annotated[Rows, _columns("x, y, radius", positive=(2,))] = []
    """Vertical cylinders."""
    people: list[RouteFile] = []
    """People on closed polylines at constant speed."""
    magnets: Annotated[Rows, _columns("x, y, strength, decay", positive=(3,), optional=1)] = []
    """Magnetic sources that disturb compasses: position, heading error within 1 m, and exponent of its decay with
    distance (3 for a dipole, the default)."""
    closures: Annotated[Rows, _columns("x0, y0, x1, y1")] = []
    """Thin walls that close gaps of the source geometry."""


def _thick_wall(x0: float, y0: float, x1: float, y1: float, thickness: float) -> np.ndarray:
    length = math.hypot(x1 - x0, y1 - y0) + thickness
    return box((x0 + x1) / 2, (y0 + y1) / 2, length, thickness, math.atan2(y1 - y0, x1 - x0))


def _contains(polygon: np.ndarray, x: float, y: float) -> bool:
    x0, y0, x1, y1 = edges(polygon).T
    crosses = (y0 > y) != (y1 > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        right = x < x0 + (y - y0) * (x1 - x0) / (y1 - y0)
    return bool(np.count_nonzero(crosses & right) % 2)


def build_world(name: str, file: WorldFile) -> World:
    """Build a world from the content of a world file.

    Raises:
        ValueError: the world is empty or not closed, or a spawn or goal is in collision.
    """
    solids = [box(*row) for row in file.boxes]
    solids += [np.array(loop) for loop in file.polygons]
    solids += [_thick_wall(*row) for row in file.segments if len(row) == 5]
    thin = [row for row in file.segments if len(row) == 4] + file.closures
    walls = [edges(solid) for solid in solids]
    walls += [edges(np.array(line))[:-1] for line in file.polylines]
    walls += [np.array(thin)] if thin else []
    segments = np.concatenate(walls) if walls else np.empty((0, 4))
    segments = segments[(segments[:, :2] != segments[:, 2:]).any(axis=1)]
    circles = np.array(file.cylinders, dtype=np.float64).reshape(-1, 3)
    if len(segments) + len(circles) == 0:
        raise ValueError("the world is empty; give boxes, polygons, polylines, segments or cylinders")
    for what, (x, y, _) in [("spawn", row) for row in file.spawns] + [("goal", row) for row in file.goals]:
        is_in_circle = (np.hypot(*(circles[:, :2] - (x, y)).T) <= circles[:, 2]).any()
        if is_in_circle or any(_contains(solid, x, y) for solid in solids):
            raise ValueError(f"{what} ({x}, {y}) lies inside a solid body")
    low = np.vstack([segments[:, :2], segments[:, 2:], circles[:, :2] - circles[:, 2:]]).min(axis=0)
    high = np.vstack([segments[:, :2], segments[:, 2:], circles[:, :2] + circles[:, 2:]]).max(axis=0)
    world = World(
        name=name,
        segments=np.ascontiguousarray(segments, dtype=np.float64),
        circles=circles,
        magnets=np.array([(*row, DIPOLE_DECAY)[:4] for row in file.magnets]).reshape(-1, 4),
        spawns=tuple(Pose2D(*row) for row in file.spawns),
        bounds=(float(low[0]), float(low[1]), float(high[0]), float(high[1])),
        people=tuple(FixedRoute(one.radius, np.array(one.waypoints), one.speed) for one in file.people),
        goals=tuple(Pose2D(*row) for row in file.goals),
        docks=tuple(Pose2D(*row) for row in file.docks),
        height=file.height,
        source=file.source,
        licence=file.licence,
        notes=file.notes,
    )
    return check_world(world)

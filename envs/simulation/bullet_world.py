"""PyBullet client, and collision bodies of ground, walls and people."""

import math
import os
import weakref
from functools import partial
from types import ModuleType
from typing import Any

import numpy as np

from lidarnaut.envs.worlds import World

from .contact import select_near

GROUND, OBSTACLES, ROLLING, CHASSIS = 1, 2, 4, 8
"""PyBullet collision groups. Wheels and casters (`ROLLING`) touch only the ground."""
_MESH_RECTANGLES = 30_000
"""Maximum number of wall rectangles per collision mesh. PyBullet allows 131,072 vertices."""
_MAX_RECTANGLES = 100_000
"""Number of wall rectangles above which only walls near the robots are created."""
_RECTANGLES_PER_CIRCLE = 32
_REBUILD_DISTANCE = 2.0


def import_pybullet() -> ModuleType:
    """Import PyBullet with standard error suppressed.

    Raises:
        ImportError: PyBullet cannot be imported.
    """
    stderr, null = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 2)
    try:
        import pybullet
    except Exception as error:  # builds for another Python or NumPy raise other exceptions
        raise ImportError(
            f"physics='bullet' needs PyBullet, which cannot be imported ({error}): `pip install pybullet-arm64` for "
            "Python 3.12 and 3.13, otherwise `pybullet` (a build needs g++, python3-dev), or use physics='kinematic'"
        ) from error
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)
        os.close(null)
    return pybullet


class BulletClient:
    """PyBullet's functions and constants as attributes. Functions are bound to one physics client."""

    def __init__(self) -> None:
        self._module = import_pybullet()
        self._id = self._module.connect(self._module.DIRECT)
        self.close = weakref.finalize(self, self._module.disconnect, self._id)

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._module, name)
        if callable(found):
            found = partial(found, physicsClientId=self._id)
        setattr(self, name, found)
        return found


def build_world(bullet: BulletClient, world: World, radii: np.ndarray) -> list[int]:
    """Create ground, walls and people in PyBullet, and return the body ids of the people.

    Very many walls are left to `NearbyWalls`. `radii`: radii of the people, shape (n,) [m].
    """
    plane = bullet.createCollisionShape(bullet.GEOM_PLANE)
    meshes = [] if has_many_walls(world) else build_meshes(bullet, outlines(world), world.height)
    cylinder = partial(bullet.createCollisionShape, bullet.GEOM_CYLINDER, height=world.height)
    cylinders = [cylinder(radius=radius) for radius in radii.tolist()]
    bodies = [bullet.createMultiBody(0.0, shape) for shape in (plane, *meshes, *cylinders)]
    set_contact(bullet, bodies[0], GROUND, ROLLING)
    for body in bodies[1:]:
        set_contact(bullet, body, OBSTACLES, CHASSIS)
    return bodies[1 + len(meshes) :]


def set_contact(bullet: BulletClient, body: int, group: int, mask: int) -> None:
    """Set collision group, collision mask and friction of a body."""
    bullet.setCollisionFilterGroupMask(body, -1, group, mask)
    bullet.changeDynamics(body, -1, lateralFriction=1.0, restitution=0.0)


def has_many_walls(world: World) -> bool:
    """Return True if a world has too many walls to create all of them in PyBullet."""
    return len(world.segments) + _RECTANGLES_PER_CIRCLE * len(world.circles) > _MAX_RECTANGLES


def outlines(world: World, sagitta: float = 5e-4) -> np.ndarray:
    """Return all obstacles of a world as line segments (x0, y0, x1, y1), shape (n, 4), float64 [m].

    Polygons approximate circles with an error of at most `sagitta` [m].
    """
    found = [world.segments]
    for x, y, radius in world.circles.tolist():
        corners = max(12, math.ceil(math.pi / math.acos(max(1.0 - sagitta / radius, 0.0))))
        angles = np.arange(corners + 1) * (2.0 * math.pi / corners)
        points = np.column_stack([x + radius * np.cos(angles), y + radius * np.sin(angles)])
        found.append(np.hstack([points[:-1], points[1:]]))
    return np.vstack(found)


# PyBullet never frees the lists of a mesh; sharing them limits the leak.
_POINTS: list[list[float]] = []
_NUMBERS: list[int] = []
_VERTICES: list[list[float]] = []
_TRIANGLES: list[int] = []


def build_meshes(bullet: BulletClient, segments: np.ndarray, height: float) -> list[int]:
    """Create PyBullet meshes of upright rectangles over line segments, shape (n, 4) [m], and return the shape ids."""
    meshes = []
    for first in range(0, len(segments), _MESH_RECTANGLES):
        part = segments[first : first + _MESH_RECTANGLES]
        corners = np.zeros((len(part), 4, 3))
        corners[:, 0, :2] = corners[:, 3, :2] = part[:, :2]
        corners[:, 1, :2] = corners[:, 2, :2] = part[:, 2:]
        corners[:, 2:, 2] = height
        vertices = corners.reshape(-1, 3)
        triangles = np.array([0, 1, 2, 0, 2, 3]) + 4 * np.arange(len(part))[:, None]
        _POINTS.extend([0.0, 0.0, 0.0] for _ in range(len(vertices) - len(_POINTS)))
        _NUMBERS.extend(range(len(_NUMBERS), len(vertices)))
        for point, x, y, z in zip(_POINTS, *vertices.T.tolist()):
            point[0], point[1], point[2] = x, y, z
        _VERTICES[:] = _POINTS[: len(vertices)]
        _TRIANGLES[:] = [_NUMBERS[corner] for corner in triangles.ravel().tolist()]
        flags = bullet.GEOM_FORCE_CONCAVE_TRIMESH | bullet.GEOM_CONCAVE_INTERNAL_EDGE
        made = bullet.createCollisionShape(bullet.GEOM_MESH, vertices=_VERTICES, indices=_TRIANGLES, flags=flags)
        meshes.append(made)
    return meshes


class NearbyWalls:
    """Walls near the robots in PyBullet, for worlds with too many walls."""

    def __init__(self, bullet: BulletClient, world: World, reach: float) -> None:
        self._bullet = bullet
        self._segments = outlines(world)
        self._height = world.height
        self._reach = reach
        self._near = np.empty(len(self._segments) + 1, dtype=np.int64)
        self._bodies: list[int] = []
        self._centers: np.ndarray | None = None

    def follow(self, positions: np.ndarray) -> None:
        """Replace the walls in PyBullet by the walls near the robots, if a robot has moved far.

        `positions`: (x, y) of the robots, shape (n, 2) [m].
        """
        if self._centers is not None and np.hypot(*(positions - self._centers).T).max() <= _REBUILD_DISTANCE:
            return
        self._centers = positions.copy()
        for body in self._bodies:
            self._bullet.removeBody(body)
        found = []
        for x, y in positions:
            count = select_near(x, y, _REBUILD_DISTANCE + self._reach, self._segments, self._near)
            found.append(self._near[:count].copy())
        chosen = self._segments[np.unique(np.concatenate(found))]
        shapes = build_meshes(self._bullet, chosen, self._height) if len(chosen) else []
        self._bodies = [self._bullet.createMultiBody(0.0, shape) for shape in shapes]
        for body in self._bodies:
            set_contact(self._bullet, body, OBSTACLES, CHASSIS)

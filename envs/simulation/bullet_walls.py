"""The static part of a world for PyBullet: upright meshes, all of them or those around the robots."""

import math

import numpy as np

from envs.worlds import World

from .bullet_client import BulletClient
from .contact import select_near

GROUND, OBSTACLES, ROLLING, CHASSIS = 1, 2, 4, 8
"""Collision groups: wheels and casters touch the ground alone, the chassis obstacles and other robots."""

_MESH_VERTICES = 120_000
"""Greatest number of vertices of one mesh, a multiple of 4: PyBullet refuses more than 131,072."""
_MANY = 100_000
"""Rectangles from which on a world has many walls, which would take PyBullet long to build."""
_PER_CIRCLE = 32
"""Rectangles that stand for a circle of 0.1 m; larger ones have more."""
_SLACK = 2.0
"""How far robots drive before the walls around them are built again, in a world with many [m]."""


def has_many_walls(world: World) -> bool:
    """Tell whether a world has too many walls for PyBullet to hold all of them."""
    return len(world.segments) + _PER_CIRCLE * len(world.circles) > _MANY


def polygon(x: float, y: float, radius: float, sagitta: float) -> np.ndarray:
    """Return the outline of a circle as segments, shape (k, 4) [m], off the circle by at most `sagitta` [m]."""
    corners = max(12, math.ceil(math.pi / math.acos(max(1.0 - sagitta / radius, 0.0))))
    angles = np.arange(corners + 1) * (2.0 * math.pi / corners)
    points = np.column_stack([x + radius * np.cos(angles), y + radius * np.sin(angles)])
    return np.hstack([points[:-1], points[1:]])


def outlines(world: World, sagitta: float = 5e-4) -> np.ndarray:
    """Return the static part of a world as segments, shape (n, 4), float64 [m].

    Polygons stand for circles, at a distance of at most `sagitta` [m].
    """
    polygons = [polygon(x, y, radius, sagitta) for x, y, radius in world.circles.tolist()]
    return np.vstack([world.segments, *polygons]) if polygons else world.segments


def extrude(segments: np.ndarray, height: float) -> tuple[np.ndarray, np.ndarray]:
    """Return segments, shape (n, 4) [m], as rectangles of two triangles each that stand upright, `height` [m].

    Returns:
        Vertices, shape (4 n, 3), float64 [m], and triangles, shape (6 n,), int64.
    """
    count = len(segments)
    vertices = np.zeros((count, 4, 3))
    vertices[:, 0, :2] = vertices[:, 3, :2] = segments[:, :2]
    vertices[:, 1, :2] = vertices[:, 2, :2] = segments[:, 2:]
    vertices[:, 2:, 2] = height
    triangles = np.array([0, 1, 2, 0, 2, 3]) + 4 * np.arange(count)[:, None]
    return vertices.reshape(-1, 3), triangles.ravel()


# PyBullet never lets go of the lists that it reads a mesh from, nor of what they hold: fresh ones leak a third of a
# megabyte for a world of 350 segments. So the same objects are filled anew for every mesh.
_POINTS: list[list[float]] = []
_NUMBERS: list[int] = []
_VERTICES: list[list[float]] = []
_TRIANGLES: list[int] = []


def build_mesh(bullet: BulletClient, vertices: np.ndarray, triangles: np.ndarray) -> int:
    """Return the id of a collision shape made of triangles, smooth where they join; see `extrude` for the arguments."""
    _POINTS.extend([0.0, 0.0, 0.0] for _ in range(len(vertices) - len(_POINTS)))
    _NUMBERS.extend(range(len(_NUMBERS), len(vertices)))
    # By columns: a list for each vertex would keep the garbage collector busy.
    for point, x, y, z in zip(_POINTS, *vertices.T.tolist()):
        point[0], point[1], point[2] = x, y, z
    _VERTICES[:] = _POINTS[: len(vertices)]
    _TRIANGLES[:] = [_NUMBERS[corner] for corner in triangles.tolist()]
    flags = bullet.GEOM_FORCE_CONCAVE_TRIMESH | bullet.GEOM_CONCAVE_INTERNAL_EDGE
    shape: int = bullet.createCollisionShape(bullet.GEOM_MESH, vertices=_VERTICES, indices=_TRIANGLES, flags=flags)
    return shape


def build_meshes(bullet: BulletClient, segments: np.ndarray, height: float) -> list[int]:
    """Return the ids of collision shapes for segments; see `extrude` for the arguments."""
    vertices, triangles = extrude(segments, height)
    meshes = []
    for first in range(0, len(vertices), _MESH_VERTICES):
        part = vertices[first : first + _MESH_VERTICES]
        meshes.append(build_mesh(bullet, part, triangles[: 6 * len(part) // 4]))
    return meshes


def set_contact(bullet: BulletClient, body: int, group: int, mask: int) -> None:
    """Set the collision group of a body of the world, what it touches, and how."""
    bullet.setCollisionFilterGroupMask(body, -1, group, mask)
    bullet.changeDynamics(body, -1, lateralFriction=1.0, restitution=0.0)


class NearbyWalls:
    """The walls around the robots, in a world that has too many for PyBullet."""

    def __init__(self, bullet: BulletClient, world: World, reach: float) -> None:
        """Take the world; robots drive no farther than `reach` [m] between two calls of `follow`, with their bodies.

        A mover that pushes a robot faster than it drives can push it past the walls that are built.
        """
        self._bullet = bullet
        self._segments = outlines(world)
        self._height = world.height
        self._reach = reach
        self._near = np.empty(len(self._segments) + 1, dtype=np.int64)
        self._bodies: list[int] = []
        self._centers: np.ndarray | None = None

    def follow(self, positions: np.ndarray) -> None:
        """Build the walls around the robots anew if one has come too far; positions: shape (n, 2), float64 [m].

        PyBullet removes bodies, but keeps the shapes of meshes until the simulation is reset.
        """
        if self._centers is not None and np.hypot(*(positions - self._centers).T).max() <= _SLACK:
            return
        self._centers = positions.copy()
        for body in self._bodies:
            self._bullet.removeBody(body)
        found = []
        for x, y in positions:
            count = select_near(x, y, _SLACK + self._reach, self._segments, self._near)
            found.append(self._near[:count].copy())
        chosen = self._segments[np.unique(np.concatenate(found))]
        shapes = build_meshes(self._bullet, chosen, self._height) if len(chosen) else []
        self._bodies = [self._bullet.createMultiBody(0.0, shape) for shape in shapes]
        for body in self._bodies:
            set_contact(self._bullet, body, OBSTACLES, CHASSIS)

"""Bodies for PyBullet: the world as one mesh, and the robot as a chassis on two wheels and casters."""

import math

import numpy as np

from envs.robots import BodyParams, RobotParams
from envs.worlds import World

from .bullet_client import BulletClient

GROUND, OBSTACLES, ROLLING, CHASSIS = 1, 2, 4, 8
"""Collision groups: wheels and casters touch the ground alone, the chassis obstacles and other robots."""
WHEEL_LINKS = (0, 1)
"""Links of the left and the right wheel."""
CHASSIS_LINK = 2
"""Link of the chassis."""

_LIGHT = 1e-3
"""Mass of the base and of each caster, as a fraction of the body's."""
_PLATE = 0.01
"""Thickness of the part of the body that touches obstacles. It lies at the height of the axle, or of the centre of mass
where that is lower, where neither the wheels' push nor the body's momentum tips the robot over [m]."""
_MESH_VERTICES = 120_000
"""Greatest number of vertices of one mesh, a multiple of 4: PyBullet refuses more than 131,072."""
_UNSTOPPABLE = 1e4
"""Mass of a mover [kg]."""
_ROTOR = 0.25
"""Inertia of a wheel with its motor's rotor as the gears transmit it, as a fraction of the body's mass times the square
of the wheel's radius. Without it the few iterations of the solver do not reconcile motors with friction: wheels that
weigh next to nothing between a heavy body and the ground leave errors of several percent in speed."""


def polygon(x: float, y: float, radius: float, sagitta: float) -> np.ndarray:
    """Return the outline of a circle as segments, shape (k, 4) [m], off the circle by at most `sagitta` [m]."""
    corners = max(12, math.ceil(math.pi / math.acos(max(1.0 - sagitta / radius, 0.0))))
    angles = np.arange(corners + 1) * (2.0 * math.pi / corners)
    points = np.column_stack([x + radius * np.cos(angles), y + radius * np.sin(angles)])
    return np.hstack([points[:-1], points[1:]])


def extrude(world: World, sagitta: float = 5e-4) -> tuple[np.ndarray, np.ndarray]:
    """Return the static part of a world as upright rectangles of two triangles each.

    Args:
        world: the world.
        sagitta: greatest distance between a circle and the polygon that stands for it [m].

    Returns:
        Vertices, shape (4 n, 3), float64 [m], and triangles, shape (6 n,), int64.
    """
    polygons = [polygon(x, y, radius, sagitta) for x, y, radius in world.circles.tolist()]
    outlines = np.vstack([world.segments, *polygons])
    count = len(outlines)
    vertices = np.zeros((count, 4, 3))
    vertices[:, 0, :2] = vertices[:, 3, :2] = outlines[:, :2]
    vertices[:, 1, :2] = vertices[:, 2, :2] = outlines[:, 2:]
    vertices[:, 2:, 2] = world.height
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
    for point, vertex in zip(_POINTS, vertices.tolist()):
        point[:] = vertex
    _VERTICES[:] = _POINTS[: len(vertices)]
    _TRIANGLES[:] = [_NUMBERS[corner] for corner in triangles.tolist()]
    flags = bullet.GEOM_FORCE_CONCAVE_TRIMESH | bullet.GEOM_CONCAVE_INTERNAL_EDGE
    shape: int = bullet.createCollisionShape(bullet.GEOM_MESH, vertices=_VERTICES, indices=_TRIANGLES, flags=flags)
    return shape


def build_world(bullet: BulletClient, world: World) -> list[int]:
    """Put ground, walls and movers into an empty simulation; return the ids of the movers.

    A mover is a heavy body whose pose and velocity are set in every substep: what it walks into is pushed aside.
    """
    plane = bullet.createCollisionShape(bullet.GEOM_PLANE)
    vertices, triangles = extrude(world)
    meshes = []
    for first in range(0, len(vertices), _MESH_VERTICES):
        part = vertices[first : first + _MESH_VERTICES]
        meshes.append(build_mesh(bullet, part, triangles[: 6 * len(part) // 4]))
    cylinders = [
        bullet.createCollisionShape(bullet.GEOM_CYLINDER, radius=mover.radius, height=world.height)
        for mover in world.movers
    ]
    static = [bullet.createMultiBody(0.0, shape) for shape in (plane, *meshes)]
    movers = [bullet.createMultiBody(_UNSTOPPABLE, shape) for shape in cylinders]
    for body in (*static, *movers):
        group, mask = (GROUND, ROLLING) if body == static[0] else (OBSTACLES, CHASSIS)
        bullet.setCollisionFilterGroupMask(body, -1, group, mask)
        bullet.changeDynamics(body, -1, lateralFriction=1.0, restitution=0.0)
    return movers


def build_robot(bullet: BulletClient, robot: RobotParams) -> int:
    """Put the robot into the simulation and return its id.

    The base is the middle of the axle. Were it the centre of mass, which turns about the axle, every substep would
    carry it off along the tangent, and a robot that turns on the spot would creep. Links: the left wheel, the right
    wheel, the chassis, then the casters. Wheels are spheres to the ground, so that they touch it in one point,
    exactly under their middle.
    """
    body, drive = robot.body, robot.drive
    radius, half_track = drive.wheel_radius, 0.5 * drive.track
    center_of_mass = body.center_of_mass or body.center
    plate = (body.center[0], body.center[1], min(radius, center_of_mass[2]))
    positions = [(0.0, half_track, radius), (0.0, -half_track, radius), plate]
    positions += [(caster.x, caster.y, caster.radius + caster.clearance) for caster in robot.casters]
    shapes = [_sphere(bullet, radius)] * 2 + [_plate(bullet, robot)]
    shapes += [_sphere(bullet, caster.radius) for caster in robot.casters]
    count, casters = len(positions), len(robot.casters)
    light = _LIGHT * body.mass
    offsets = np.zeros((count, 3))
    offsets[CHASSIS_LINK] = np.subtract(center_of_mass, plate)
    upright = [0.0, 0.0, 0.0, 1.0]
    robot_id: int = bullet.createMultiBody(
        baseMass=light,
        linkMasses=[drive.wheel_mass] * 2 + [body.mass] + [light] * casters,
        linkCollisionShapeIndices=shapes,
        linkVisualShapeIndices=[-1] * count,
        linkPositions=(np.array(positions) - (0.0, 0.0, radius)).tolist(),
        linkOrientations=[upright] * count,
        linkInertialFramePositions=offsets.tolist(),
        linkInertialFrameOrientations=[upright] * count,
        linkParentIndices=[0] * count,
        linkJointTypes=[bullet.JOINT_REVOLUTE] * 2 + [bullet.JOINT_FIXED] * (1 + casters),
        linkJointAxis=[[0.0, 1.0, 0.0]] * count,
    )
    rolling = [_ROTOR * body.mass * radius**2] * 3
    inertias = {WHEEL_LINKS[0]: rolling, WHEEL_LINKS[1]: rolling, CHASSIS_LINK: _inertia(body)}
    # Were a square body slippery, then of the two wheels of a robot whose turn a wall blocks the faster one, on which
    # more weight rests, would drag it along the wall, faster than it can drive.
    frictions = {WHEEL_LINKS[0]: drive.friction, WHEEL_LINKS[1]: drive.friction, CHASSIS_LINK: body.friction}
    for link in range(-1, count):
        bullet.changeDynamics(
            robot_id,
            link,
            lateralFriction=frictions.get(link, 0.0),
            restitution=0.0,
            linearDamping=0.0,
            angularDamping=0.0,
            jointDamping=0.0,
        )
        if link in inertias:
            bullet.changeDynamics(robot_id, link, localInertiaDiagonal=inertias[link])
        group, mask = (CHASSIS, OBSTACLES | CHASSIS) if link == CHASSIS_LINK else (ROLLING, GROUND)
        bullet.setCollisionFilterGroupMask(robot_id, link, group, mask)
    return robot_id


def _sphere(bullet: BulletClient, radius: float) -> int:
    return bullet.createCollisionShape(bullet.GEOM_SPHERE, radius=radius)


def _plate(bullet: BulletClient, robot: RobotParams) -> int:
    """Return the id of the shape that touches obstacles: the body's outline, `_PLATE` thick.

    Obstacles stand upright, so that the outline alone decides what it touches. A body of full height would touch a
    wall in one corner after another, one in a substep, and rock itself into it.
    """
    body = robot.body
    if body.size is None:
        return bullet.createCollisionShape(bullet.GEOM_CYLINDER, radius=body.radius, height=_PLATE)
    half = [0.5 * body.size[0], 0.5 * body.size[1], 0.5 * _PLATE]
    return bullet.createCollisionShape(bullet.GEOM_BOX, halfExtents=half)


def _inertia(body: BodyParams) -> list[float]:
    """Return the principal moments of inertia of the body, solid and even [kg m2]."""
    if body.size is not None:
        x, y, z = (body.mass * side**2 / 12.0 for side in body.size)
        return [y + z, x + z, x + y]
    radius, height = body.radius or 0.0, body.height or 0.0
    across = body.mass * (3.0 * radius**2 + height**2) / 12.0
    return [across, across, 0.5 * body.mass * radius**2]

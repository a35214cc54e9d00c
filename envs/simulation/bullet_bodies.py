"""Bodies for PyBullet: the world as one mesh, and the robot as a chassis on two wheels and casters."""

import math
import os
from types import ModuleType

import numpy as np

from envs.robots import RobotParams
from envs.worlds import World

GROUND, OBSTACLES, ROLLING, CHASSIS = 1, 2, 4, 8
"""Collision groups: wheels and casters touch the ground alone, the chassis obstacles alone."""
WHEEL_LINKS = (0, 1)
"""Links of the left and the right wheel."""
CHASSIS_LINK = 2
"""Link of the chassis."""
SAGITTA = 5e-4
"""Greatest distance between a circle and the polygon that stands for it [m]."""

_LIGHT = 1e-3
"""Mass of the base and of each caster, as a fraction of the body's."""
_ROTOR = 0.5
"""Inertia of a wheel with its motor's rotor as the gears transmit it, as a fraction of the body's mass times the square
of the wheel's radius. Without it ten iterations of the solver do not reconcile motors with friction: wheels that weigh
next to nothing between a heavy body and the ground leave errors of several percent in speed."""


def import_pybullet() -> ModuleType:
    """Import PyBullet without the line that it prints on standard error.

    Raises:
        ImportError: it is not installed; the message says how to get it.
    """
    stderr, null = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 2)
    try:
        import pybullet
    except ImportError as error:
        raise ImportError(
            "physics='bullet' needs PyBullet, which has wheels for Linux x86_64 and Python 3.11 and older: "
            "install it there with `pip install pybullet`, or use physics='kinematic'"
        ) from error
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)
        os.close(null)
    return pybullet


def polygon(x: float, y: float, radius: float) -> np.ndarray:
    """Return the outline of a circle as segments, shape (k, 4) [m], off the circle by at most `SAGITTA`."""
    corners = max(12, math.ceil(math.pi / math.acos(max(1.0 - SAGITTA / radius, 0.0))))
    angles = np.arange(corners + 1) * (2.0 * math.pi / corners)
    points = np.column_stack([x + radius * np.cos(angles), y + radius * np.sin(angles)])
    return np.hstack([points[:-1], points[1:]])


def extrude(world: World) -> tuple[np.ndarray, np.ndarray]:
    """Return the static part of a world as upright rectangles of two triangles each.

    Returns:
        Vertices, shape (4 n, 3), float64 [m], and triangles, shape (6 n,), int64.
    """
    outlines = np.vstack([world.segments, *(polygon(*circle) for circle in world.circles)])
    count = len(outlines)
    vertices = np.zeros((count, 4, 3))
    vertices[:, 0, :2] = vertices[:, 3, :2] = outlines[:, :2]
    vertices[:, 1, :2] = vertices[:, 2, :2] = outlines[:, 2:]
    vertices[:, 2:, 2] = world.height
    triangles = np.array([0, 1, 2, 0, 2, 3]) + 4 * np.arange(count)[:, None]
    return vertices.reshape(-1, 3), triangles.ravel()


def build_world(bullet: ModuleType, client: int, world: World) -> tuple[int, list[int]]:
    """Put ground, walls and movers into an empty simulation; return the ids of the walls and of the movers."""
    plane = bullet.createCollisionShape(bullet.GEOM_PLANE, physicsClientId=client)
    vertices, triangles = extrude(world)
    mesh = bullet.createCollisionShape(
        bullet.GEOM_MESH,
        vertices=vertices.tolist(),
        indices=triangles.tolist(),
        flags=bullet.GEOM_FORCE_CONCAVE_TRIMESH,
        physicsClientId=client,
    )
    cylinders = [
        bullet.createCollisionShape(
            bullet.GEOM_CYLINDER, radius=mover.radius, height=world.height, physicsClientId=client
        )
        for mover in world.movers
    ]
    ground, walls, *movers = (
        bullet.createMultiBody(0.0, shape, physicsClientId=client) for shape in (plane, mesh, *cylinders)
    )
    for body in (ground, walls, *movers):
        group, mask = (GROUND, ROLLING) if body == ground else (OBSTACLES, CHASSIS)
        bullet.setCollisionFilterGroupMask(body, -1, group, mask, physicsClientId=client)
        bullet.changeDynamics(body, -1, lateralFriction=1.0, restitution=0.0, physicsClientId=client)
    return walls, movers


def build_robot(bullet: ModuleType, client: int, robot: RobotParams) -> int:
    """Put the robot into the simulation and return its id.

    The base is the middle of the axle. Were it the centre of mass, which turns about the axle, every substep would
    carry it off along the tangent, and a robot that turns on the spot would creep. Links: the left wheel, the right
    wheel, the chassis, then the casters. Wheels are spheres to the ground, so that they touch it in one point,
    exactly under their middle.
    """
    body, drive = robot.body, robot.drive
    radius, half_track = drive.wheel_radius, 0.5 * drive.track
    places = [(0.0, half_track, radius), (0.0, -half_track, radius), body.center]
    places += [(caster.x, caster.y, caster.radius + caster.clearance) for caster in robot.casters]
    shapes = [_sphere(bullet, client, radius)] * 2 + [_chassis(bullet, client, robot)]
    shapes += [_sphere(bullet, client, caster.radius) for caster in robot.casters]
    count, casters = len(places), len(robot.casters)
    light = _LIGHT * body.mass
    offsets = np.zeros((count, 3))
    offsets[CHASSIS_LINK] = np.subtract(body.center_of_mass or body.center, body.center)
    upright = [0.0, 0.0, 0.0, 1.0]
    robot_id: int = bullet.createMultiBody(
        baseMass=light,
        linkMasses=[drive.wheel_mass] * 2 + [body.mass] + [light] * casters,
        linkCollisionShapeIndices=shapes,
        linkVisualShapeIndices=[-1] * count,
        linkPositions=(np.array(places) - (0.0, 0.0, radius)).tolist(),
        linkOrientations=[upright] * count,
        linkInertialFramePositions=offsets.tolist(),
        linkInertialFrameOrientations=[upright] * count,
        linkParentIndices=[0] * count,
        linkJointTypes=[bullet.JOINT_REVOLUTE] * 2 + [bullet.JOINT_FIXED] * (1 + casters),
        linkJointAxis=[[0.0, 1.0, 0.0]] * count,
        physicsClientId=client,
    )
    rolling = _ROTOR * body.mass * radius**2
    for link in range(-1, count):
        bullet.changeDynamics(
            robot_id,
            link,
            lateralFriction=drive.friction if link in WHEEL_LINKS else 0.0,
            restitution=0.0,
            linearDamping=0.0,
            angularDamping=0.0,
            jointDamping=0.0,
            physicsClientId=client,
        )
        if link in WHEEL_LINKS:
            bullet.changeDynamics(robot_id, link, localInertiaDiagonal=[rolling] * 3, physicsClientId=client)
        group, mask = (CHASSIS, OBSTACLES) if link == CHASSIS_LINK else (ROLLING, GROUND)
        bullet.setCollisionFilterGroupMask(robot_id, link, group, mask, physicsClientId=client)
    return robot_id


def _sphere(bullet: ModuleType, client: int, radius: float) -> int:
    return bullet.createCollisionShape(bullet.GEOM_SPHERE, radius=radius, physicsClientId=client)


def _chassis(bullet: ModuleType, client: int, robot: RobotParams) -> int:
    body = robot.body
    if body.size is None:
        return bullet.createCollisionShape(
            bullet.GEOM_CYLINDER, radius=body.radius, height=body.height, physicsClientId=client
        )
    half = [0.5 * side for side in body.size]
    return bullet.createCollisionShape(bullet.GEOM_BOX, halfExtents=half, physicsClientId=client)

"""Bodies for PyBullet: ground, walls and movers, and the robot as a chassis on two wheels and casters."""

import numpy as np

from envs.robots import BodyParams, RobotParams
from envs.worlds import World

from .bullet_client import BulletClient
from .bullet_walls import CHASSIS, GROUND, OBSTACLES, ROLLING, build_meshes, has_many_walls, outlines, set_contact

WHEEL_LINKS = (0, 1)
"""Links of the left and the right wheel."""
CHASSIS_LINK = 2
"""Link of the chassis."""

_LIGHT = 1e-3
"""Mass of the base and of each caster, as a fraction of the body's."""
_PLATE = 0.01
"""Thickness of the part of the body that touches obstacles. It lies at the height of the axle, or of the centre of mass
where that is lower, where neither the wheels' push nor the body's momentum tips the robot over [m]."""
_UNSTOPPABLE = 1e4
"""Mass of a mover [kg]."""
_ROTOR = 0.25
"""Inertia of a wheel with its motor's rotor as the gears transmit it, as a fraction of the body's mass times the square
of the wheel's radius. Without it the few iterations of the solver do not reconcile motors with friction: wheels that
weigh next to nothing between a heavy body and the ground leave errors of several percent in speed."""


def build_world(bullet: BulletClient, world: World) -> list[int]:
    """Put ground, walls and movers into an empty simulation; return the ids of the movers.

    A mover is a heavy body whose pose and velocity are set in every substep: what it walks into is pushed aside. The
    walls of a world with very many are left to `NearbyWalls`.
    """
    plane = bullet.createCollisionShape(bullet.GEOM_PLANE)
    meshes = [] if has_many_walls(world) else build_meshes(bullet, outlines(world), world.height)
    cylinders = [
        bullet.createCollisionShape(bullet.GEOM_CYLINDER, radius=mover.radius, height=world.height)
        for mover in world.movers
    ]
    static = [bullet.createMultiBody(0.0, shape) for shape in (plane, *meshes)]
    movers = [bullet.createMultiBody(_UNSTOPPABLE, shape) for shape in cylinders]
    for body in (*static, *movers):
        group, mask = (GROUND, ROLLING) if body == static[0] else (OBSTACLES, CHASSIS)
        set_contact(bullet, body, group, mask)
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

"""Rigid-body model of a differential-drive robot in PyBullet."""

import math
from collections.abc import Sequence
from functools import partial

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry import Pose2D, wrap_angle
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.worlds import World

from .bullet_world import CHASSIS, GROUND, OBSTACLES, ROLLING, BulletClient
from .contact import is_cut
from .kinematic import plan_wheels
from .records import robot_record, unpack_robot

WHEEL_LINKS = (0, 1)
CHASSIS_LINK = 2

_LINK_MASS_RATIO = 1e-3
"""Mass of the base link and of each caster, divided by the mass of the body."""
_PLATE_HEIGHT = 0.01
"""Thickness of the collision shape of the chassis [m]."""
_WHEEL_INERTIA_RATIO = 0.25
"""Moment of inertia of a wheel with motor, divided by body mass times squared wheel radius."""
_OTHER_BODY, _NORMAL_FORCE = 2, 9
_LIFT_HEIGHT = 1e3
_MIN_COS_TILT = math.cos(math.radians(20.0))
_MAX_PENETRATION = 0.01
"""Tolerated depth of a robot's body inside a wall, in addition to the travel in a physics step [m]. A deeper robot
returns to its last pose."""
_MAX_PENETRATION_RATIO = 0.25
"""Maximum tolerated depth of a robot's body inside a wall, divided by half the body's length or width."""


def build_robot(bullet: BulletClient, robot: RobotParams) -> int:
    """Create a robot in PyBullet and return its body id.

    Links: left wheel, right wheel, chassis, casters. The base is the midpoint of the axle; a base at the centre of mass
    would drift in turns on the spot.
    """
    body, drive = robot.body, robot.drive
    radius, half_track = drive.wheel_radius, 0.5 * drive.track
    center_of_mass = body.center_of_mass or body.center
    plate = (body.center[0], body.center[1], min(radius, center_of_mass[2]))
    positions = [(0.0, half_track, radius), (0.0, -half_track, radius), plate]
    positions += [(caster.x, caster.y, caster.radius + caster.clearance) for caster in robot.casters]
    sphere = partial(bullet.createCollisionShape, bullet.GEOM_SPHERE)
    shapes = [sphere(radius=radius)] * 2 + [_plate(bullet, robot)]
    shapes += [sphere(radius=caster.radius) for caster in robot.casters]
    count, casters = len(positions), len(robot.casters)
    light = _LINK_MASS_RATIO * body.mass
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
    rolling = [_WHEEL_INERTIA_RATIO * body.mass * radius**2] * 3
    inertias = {WHEEL_LINKS[0]: rolling, WHEEL_LINKS[1]: rolling, CHASSIS_LINK: body.inertia}
    # Chassis friction keeps square robots from sliding along walls.
    frictions = {WHEEL_LINKS[0]: drive.friction, WHEEL_LINKS[1]: drive.friction, CHASSIS_LINK: body.friction}
    undamped = dict.fromkeys(("restitution", "linearDamping", "angularDamping", "jointDamping"), 0.0)
    for link in range(-1, count):
        bullet.changeDynamics(robot_id, link, lateralFriction=frictions.get(link, 0.0), **undamped)
        if link in inertias:
            bullet.changeDynamics(robot_id, link, localInertiaDiagonal=inertias[link])
        group, mask = (CHASSIS, OBSTACLES | CHASSIS) if link == CHASSIS_LINK else (ROLLING, GROUND)
        bullet.setCollisionFilterGroupMask(robot_id, link, group, mask)
    return robot_id


def _plate(bullet: BulletClient, robot: RobotParams) -> int:
    size, radius = robot.body.size, robot.body.radius
    if size is None:
        return bullet.createCollisionShape(bullet.GEOM_CYLINDER, radius=radius, height=_PLATE_HEIGHT)
    return bullet.createCollisionShape(bullet.GEOM_BOX, halfExtents=[0.5 * size[0], 0.5 * size[1], 0.5 * _PLATE_HEIGHT])


@njit(cache=True, error_model="numpy")
def _plan_wheels(reached, command, normals, row, rates, slips):
    return plan_wheels(reached, command, normals, unpack_robot(row), rates, slips)


class BulletRobot:
    """Rigid body of a robot in PyBullet, with wheel controller and torque-limited motors."""

    def __init__(self, robot: RobotParams, control_period: float, row: np.void) -> None:
        record = robot_record(robot, control_period)
        self._robot, self._row = robot, row
        substeps, self._period = int(record.substeps), record.period
        self._dt = self._period / substeps
        fastest = robot.max_v * robot.drive.wheel_radius / robot.odometry.wheel_radius
        body, depth = robot.body, fastest * self._dt + _MAX_PENETRATION
        sides = (body.radius or 0.0, 0.0) if body.size is None else (0.5 * body.size[0], 0.5 * body.size[1])
        self._core = (*body.center[:2], *(side - min(depth, _MAX_PENETRATION_RATIO * side) for side in sides))
        self._rates, self._slips = np.empty((substeps, 2)), np.empty((substeps, 2))
        self.touched: set[int] = set()
        """PyBullet ids of the bodies touched during the control period."""

    def build(self, bullet: BulletClient, world: World) -> None:
        self._bullet, self._body = bullet, build_robot(bullet, self._robot)
        self._walls = world.segments, world.circles

    def move_away(self, pose: Pose2D) -> None:
        """Lift the robot above all obstacles, to clear contact impulses cached by PyBullet."""
        for wheel in WHEEL_LINKS:
            self._bullet.resetJointState(self._body, wheel, 0.0, 0.0)
        self._set_pose(pose, _LIFT_HEIGHT)

    def reset_pose(self, pose: Pose2D) -> None:
        self._settle(pose, [0.0] * 3, [0.0] * 3)
        self._row["x"], self._row["y"], self._row["theta"] = pose
        self._rolled, self._slipped = np.zeros(2), np.zeros(2)
        self.touched = set()
        self.update_state()
        self._row["mean_w"] = 0.0

    def plan(self, command: np.ndarray, normals: np.ndarray) -> None:
        """Compute and store the rates of both wheels in each physics step of a control period [rad/s].

        `command`: twist (v, w) [m/s, rad/s]. `normals`: standard normal numbers; the first two are the slip of
        the left and right wheel.
        """
        row, rates, slips = self._row, self._rates, self._slips
        reached = (row["commanded_v"], row["commanded_w"])
        row["commanded_v"], row["commanded_w"] = _plan_wheels(reached, command, normals, row, rates, slips)
        self._targets = (rates + slips).tolist()
        if self._robot.odometry.open_loop:
            self._rolled += rates.sum(axis=0) * self._dt
        self._slipped += slips.sum(axis=0) * self._dt
        self.touched = set()

    def turn_wheels(self, substep: int) -> None:
        wheels, torques = (self._body, WHEEL_LINKS), [self._robot.drive.max_torque] * 2
        goal = {"targetVelocities": self._targets[substep], "velocityGains": [1.0, 1.0], "forces": torques}
        self._bullet.setJointMotorControlArray(*wheels, self._bullet.VELOCITY_CONTROL, **goal)

    def update_contacts(self) -> None:
        points = self._bullet.getContactPoints(self._body, linkIndexA=CHASSIS_LINK)
        self.touched.update(point[_OTHER_BODY] for point in points if point[_NORMAL_FORCE] > 0.0)

    def update_state(self) -> None:
        """Read pose, velocity and wheel angles from PyBullet.

        A robot that lies upside down or has passed through a wall returns to its last pose.
        """
        (x, y, _), orientation = self._bullet.getBasePositionAndOrientation(self._body)
        linear, angular = self._bullet.getBaseVelocity(self._body)
        rotation = self._bullet.getMatrixFromQuaternion(orientation)
        theta = math.atan2(rotation[3], rotation[0])
        row = self._row
        is_back = rotation[8] < 0.0 or self._is_through((x, y, theta))
        if is_back:
            x, y, theta = self._pose
            linear = angular = (0.0, 0.0, 0.0)
            self.touched.add(self._body)
        if is_back or rotation[8] < _MIN_COS_TILT:
            self._settle(Pose2D(x, y, theta), linear, angular)
        # The commanded yaw rate determines the number of full turns.
        period, expected = self._period, row["commanded_w"]
        row["mean_w"] = expected + wrap_angle(theta - row["theta"] - expected * period) / period
        row["x"], row["y"], row["theta"] = x, y, wrap_angle(theta)
        row["v"], row["w"] = linear[0] * math.cos(theta) + linear[1] * math.sin(theta), angular[2]
        if self._robot.odometry.open_loop:
            row["left_angle"], row["right_angle"] = self._rolled
        else:
            left, right = self._bullet.getJointStates(self._body, WHEEL_LINKS)
            row["left_angle"], row["right_angle"] = left[0] - self._slipped[0], right[0] - self._slipped[1]

    def _settle(self, pose: Pose2D, linear: Sequence[float], angular: Sequence[float]) -> None:
        self._set_pose(pose, self._robot.drive.wheel_radius)
        self._bullet.resetBaseVelocity(self._body, [*linear[:2], 0.0], [0.0, 0.0, angular[2]])

    def _is_through(self, pose: tuple[float, float, float]) -> bool:
        before, core, walls = self._pose, self._core, self._walls
        # A body larger than its footprint may start inside a wall.
        return is_cut(pose, before, core, *walls) and not is_cut(before, before, core, *walls)

    @property
    def _pose(self) -> tuple[float, float, float]:
        return float(self._row["x"]), float(self._row["y"]), float(self._row["theta"])

    def _set_pose(self, pose: Pose2D, height: float) -> None:
        orientation = [0.0, 0.0, math.sin(0.5 * pose.theta), math.cos(0.5 * pose.theta)]
        self._bullet.resetBasePositionAndOrientation(self._body, [pose.x, pose.y, height], orientation)

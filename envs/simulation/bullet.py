"""A robot as a rigid body in PyBullet, driven by the motors of its two wheels."""

import math
import weakref

import numpy as np

from envs.geometry import Pose2D, wrap_angle
from envs.robots import RobotParams
from envs.worlds import World

from .bullet_bodies import CHASSIS_LINK, WHEEL_LINKS, build_robot, build_world, import_pybullet
from .contact import check_start
from .drive import Drive, check_command, count_substeps, plan_wheels
from .sensors import Sensors
from .simulator import Reading, TrueState, Twist

GRAVITY = 9.81
"""Acceleration of gravity [m/s2]."""
SOLVER_ITERATIONS = 15
"""Iterations of the constraint solver in a substep."""
CONTACT_BREAKING = 0.1
"""Distance at which a contact begins and ends, as a fraction of the smaller shape's size. At PyBullet's 0.02 wheels
drag old points of contact along, which costs time, and robots meet walls too late to stop before them."""
_NOT_CONNECTED = -1
"""Id that no physics client has."""
_NORMAL_FORCE = 9
"""Entry of a contact point that holds the force between the bodies."""
_OUT_OF_REACH = 1e3
"""Height at which a body touches nothing [m]."""


class BulletSimulator:
    """A robot in a world, moved by PyBullet; one physics client of its own, opened at the first reset.

    The controller turns the command into wheel rates as it does under the kinematic physics; motors of limited
    torque turn the wheels, and friction moves the robot. Wheel slip beyond what the contact itself yields is a
    disturbance of the wheel's rate that the encoder does not see.
    """

    def __init__(self, robot: RobotParams, control_period: float) -> None:
        import_pybullet()
        self._robot = robot
        self._drive = Drive.of(robot)
        self._period = float(control_period)
        self._substeps = count_substeps(self._drive, self._period)
        self._sensors = Sensors(robot)
        self._rates, self._slips = np.empty((self._substeps, 2)), np.empty((self._substeps, 2))
        self._client = _NOT_CONNECTED
        self._world: World
        self._steps = -1

    def __reduce__(self) -> tuple[type["BulletSimulator"], tuple[RobotParams, float]]:
        """Pickle as a new simulator: what happens in PyBullet stays there."""
        return BulletSimulator, (self._robot, self._period)

    @property
    def state(self) -> TrueState:
        """The truth after the last `reset` or `step`."""
        self._require_reset()
        return self._state

    @property
    def tilt(self) -> tuple[float, float]:
        """Roll and pitch of the body [rad]."""
        self._require_reset()
        _, orientation = self._bullet.getBasePositionAndOrientation(self._body, physicsClientId=self._client)
        roll, pitch, _ = self._bullet.getEulerFromQuaternion(orientation)
        return roll, pitch

    def reset(self, world: World, pose: Pose2D, rng: np.random.Generator) -> Reading:
        """Put the robot at rest at `pose` (world frame) and return its first reading.

        Raises:
            ValueError: the robot does not fit there.
        """
        circles = world.circles_at(0.0)
        check_start(pose, self._robot.radius, world.segments, circles, world.name)
        self._connect()
        if self._steps < 0 or world is not self._world:
            self._build(world)
        self._rng, self._circles, self._steps = rng, circles, 0
        self._commanded = (0.0, 0.0)
        self._rolled, self._slipped = np.zeros(2), np.zeros(2)
        self._place_movers(circles, np.zeros_like(circles))
        self._place_robot(pose)
        self._observe()
        return self._read(self._sensors.draw(rng), bumper=False)

    def step(self, command: Twist) -> Reading:
        """Drive with the commanded twist for one control period and return what the sensors say at its end.

        Raises:
            ValueError: the command holds NaN or infinity.
            RuntimeError: there was no reset.
        """
        self._require_reset()
        v, w = check_command(command)
        noise = self._sensors.draw(self._rng)
        self._steps += 1
        before = self._circles
        if self._world.movers:
            self._circles = self._world.circles_at(self._steps * self._period)
        normals, rates, slips = noise[0], self._rates, self._slips
        self._commanded = plan_wheels(
            *self._commanded, v, w, normals[0], normals[1], self._period, self._drive, rates, slips
        )
        self._rolled += rates.sum(axis=0) * (self._period / self._substeps)
        self._slipped += slips.sum(axis=0) * (self._period / self._substeps)
        touched = False
        for substep, targets in enumerate((rates + slips).tolist()):
            if self._world.movers:
                travel = self._circles - before
                self._place_movers(before + substep / self._substeps * travel, travel / self._period)
            self._turn_wheels(targets)
            self._bullet.stepSimulation(physicsClientId=self._client)
            touched = touched or self._touches()
        self._observe()
        return self._read(noise, touched)

    def close(self) -> None:
        """Disconnect from PyBullet. The next reset connects again."""
        if self._client != _NOT_CONNECTED:
            self._disconnect()
            self._client, self._steps = _NOT_CONNECTED, -1

    def _require_reset(self) -> None:
        if self._steps < 0:
            raise RuntimeError("call reset before step")

    def _connect(self) -> None:
        if self._client != _NOT_CONNECTED:
            return
        self._bullet = import_pybullet()
        self._client = self._bullet.connect(self._bullet.DIRECT)
        self._disconnect = weakref.finalize(self, self._bullet.disconnect, self._client)

    def _build(self, world: World) -> None:
        bullet, client = self._bullet, self._client
        bullet.resetSimulation(physicsClientId=client)
        bullet.setPhysicsEngineParameter(
            fixedTimeStep=self._period / self._substeps,
            numSubSteps=0,
            numSolverIterations=SOLVER_ITERATIONS,
            contactBreakingThreshold=CONTACT_BREAKING,
            enableConeFriction=0,  # with it the pushing wheels of a robot held by a wall turn it on the spot
            deterministicOverlappingPairs=1,
            physicsClientId=client,
        )
        bullet.setGravity(0.0, 0.0, -GRAVITY, physicsClientId=client)
        self._movers = build_world(bullet, client, world)
        self._body = build_robot(bullet, client, self._robot)
        self._world = world

    def _place_robot(self, pose: Pose2D) -> None:
        """Put the robot at rest, free of the past: contacts remember their impulses, and lifting it breaks them."""
        bullet, client = self._bullet, self._client
        for wheel in WHEEL_LINKS:
            bullet.resetJointState(self._body, wheel, 0.0, 0.0, physicsClientId=client)
        orientation = [0.0, 0.0, math.sin(0.5 * pose.theta), math.cos(0.5 * pose.theta)]
        above, ground = [pose.x, pose.y, _OUT_OF_REACH], [pose.x, pose.y, self._robot.drive.wheel_radius]
        bullet.resetBasePositionAndOrientation(self._body, above, orientation, physicsClientId=client)
        bullet.performCollisionDetection(physicsClientId=client)
        bullet.resetBasePositionAndOrientation(self._body, ground, orientation, physicsClientId=client)
        bullet.resetBaseVelocity(self._body, [0.0] * 3, [0.0] * 3, physicsClientId=client)

    def _place_movers(self, circles: np.ndarray, velocities: np.ndarray) -> None:
        bullet, client = self._bullet, self._client
        for i, mover in enumerate(self._movers, start=len(circles) - len(self._movers)):
            position = [*circles[i, :2].tolist(), 0.5 * self._world.height]
            bullet.resetBasePositionAndOrientation(mover, position, [0.0, 0.0, 0.0, 1.0], physicsClientId=client)
            velocity = [*velocities[i, :2].tolist(), 0.0]
            bullet.resetBaseVelocity(mover, velocity, [0.0] * 3, physicsClientId=client)

    def _turn_wheels(self, rates: list[float]) -> None:
        self._bullet.setJointMotorControlArray(
            self._body,
            WHEEL_LINKS,
            self._bullet.VELOCITY_CONTROL,
            targetVelocities=rates,
            velocityGains=[1.0, 1.0],
            forces=[self._robot.drive.max_torque] * 2,
            physicsClientId=self._client,
        )

    def _touches(self) -> bool:
        points = self._bullet.getContactPoints(self._body, linkIndexA=CHASSIS_LINK, physicsClientId=self._client)
        return any(point[_NORMAL_FORCE] > 0.0 for point in points)

    def _observe(self) -> None:
        (x, y, _), orientation = self._bullet.getBasePositionAndOrientation(self._body, physicsClientId=self._client)
        linear, angular = self._bullet.getBaseVelocity(self._body, physicsClientId=self._client)
        rotation = self._bullet.getMatrixFromQuaternion(orientation)
        theta = math.atan2(rotation[3], rotation[0])
        speed = linear[0] * math.cos(theta) + linear[1] * math.sin(theta)
        self._state = TrueState(Pose2D(x, y, float(wrap_angle(theta))), Twist(speed, angular[2]))

    def _read(self, noise: tuple[np.ndarray, np.ndarray], bumper: bool) -> Reading:
        return self._sensors.read(
            noise,
            self._steps * self._period,
            self._state.pose,
            self._encoder_angles(),
            self._state.twist.w,
            bumper,
            self._world.segments,
            self._circles,
        )

    def _encoder_angles(self) -> tuple[float, float]:
        if self._robot.odometry.open_loop:
            return float(self._rolled[0]), float(self._rolled[1])
        left, right = self._bullet.getJointStates(self._body, WHEEL_LINKS, physicsClientId=self._client)
        return left[0] - self._slipped[0], right[0] - self._slipped[1]

"""Robots as rigid bodies in PyBullet, driven by the motors of their two wheels."""

import weakref
from collections.abc import Sequence

import numpy as np

from envs.geometry import Pose2D
from envs.robots import RobotParams
from envs.worlds import World

from .bullet_bodies import build_world, import_pybullet
from .bullet_robot import BulletRobot
from .contact import check_start
from .simulator import Reading, TrueState, Twist
from .team import check_starts, mates_as_circles

GRAVITY = 9.81
"""Acceleration of gravity [m/s2]."""
SOLVER_ITERATIONS = 15
"""Iterations of the constraint solver in a substep."""
CONTACT_BREAKING = 0.1
"""Distance at which a contact begins and ends, as a fraction of the smaller shape's size. At PyBullet's 0.02 wheels
drag old points of contact along, which costs time, and robots meet walls too late to stop before them."""
_NOT_CONNECTED = -1
"""Id that no physics client has."""


class BulletTeam:
    """Robots in a world, moved by PyBullet; one physics client of its own, opened at the first reset.

    The lidar of each sees the others as circles, as under the kinematic physics.
    """

    def __init__(self, robot: RobotParams, control_period: float, num_robots: int) -> None:
        import_pybullet()
        self._arguments = robot, float(control_period), num_robots
        self._radius = robot.radius
        self._period = float(control_period)
        self.robots = [BulletRobot(robot, control_period) for _ in range(num_robots)]
        self._client = _NOT_CONNECTED
        self._world: World
        self._steps = -1

    def __reduce__(self) -> tuple[type["BulletTeam"], tuple[RobotParams, float, int]]:
        """Pickle as a new simulator: what happens in PyBullet stays there."""
        return BulletTeam, self._arguments

    @property
    def states(self) -> list[TrueState]:
        """The truth about each robot after the last `reset` or `step`."""
        self._require_reset()
        return [robot.state for robot in self.robots]

    def reset(self, world: World, poses: Sequence[Pose2D], rngs: Sequence[np.random.Generator]) -> list[Reading]:
        """Put the robots at rest and return their first readings; see `TeamSimulator`.

        Raises:
            ValueError: a robot does not fit where it shall start.
        """
        circles = world.circles_at(0.0)
        for pose in poses:
            check_start(pose, self._radius, world.segments, circles, world.name)
        check_starts(poses, self._radius)
        self._connect()
        if self._steps < 0 or world is not self._world:
            self._build(world)
        self._circles, self._steps = circles, 0
        self._place_movers(circles, np.zeros_like(circles))
        for robot, pose in zip(self.robots, poses, strict=True):
            robot.lift(pose)
        self._bullet.performCollisionDetection(physicsClientId=self._client)
        for robot, pose, rng in zip(self.robots, poses, rngs, strict=True):
            robot.put_down(pose, rng)
        return self._read()

    def step(self, commands: Sequence[Twist]) -> list[Reading]:
        """Drive for one control period; see `TeamSimulator`.

        Raises:
            ValueError: a command holds NaN or infinity.
            RuntimeError: there was no reset.
        """
        self._require_reset()
        for robot, command in zip(self.robots, commands, strict=True):
            robot.plan(command)
        self._steps += 1
        before, substeps = self._circles, self.robots[0].substeps
        if self._world.movers:
            self._circles = self._world.circles_at(self._steps * self._period)
        for substep in range(substeps):
            if self._world.movers:
                travel = self._circles - before
                self._place_movers(before + substep / substeps * travel, travel / self._period)
            for robot in self.robots:
                robot.turn_wheels(substep)
            self._bullet.stepSimulation(physicsClientId=self._client)
            for robot in self.robots:
                robot.feel()
        for robot in self.robots:
            robot.observe()
        return self._read()

    def close(self) -> None:
        """Disconnect from PyBullet. The next reset connects again."""
        if self._client != _NOT_CONNECTED:
            self._disconnect()
            self._client, self._steps = _NOT_CONNECTED, -1

    def _read(self) -> list[Reading]:
        time, poses = self._steps * self._period, [robot.state.pose for robot in self.robots]
        readings = []
        for k, robot in enumerate(self.robots):
            mates = mates_as_circles(poses, k, self._radius)
            circles = np.vstack([self._circles, mates]) if len(mates) else self._circles
            readings.append(robot.read(time, self._world.segments, circles))
        return readings

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
            fixedTimeStep=self._period / self.robots[0].substeps,
            numSubSteps=0,
            numSolverIterations=SOLVER_ITERATIONS,
            contactBreakingThreshold=CONTACT_BREAKING,
            enableConeFriction=0,  # with it the pushing wheels of a robot held by a wall turn it on the spot
            deterministicOverlappingPairs=1,
            physicsClientId=client,
        )
        bullet.setGravity(0.0, 0.0, -GRAVITY, physicsClientId=client)
        self._movers = build_world(bullet, client, world)
        for robot in self.robots:
            robot.build(bullet, client)
        self._world = world

    def _place_movers(self, circles: np.ndarray, velocities: np.ndarray) -> None:
        bullet, client = self._bullet, self._client
        for i, mover in enumerate(self._movers, start=len(circles) - len(self._movers)):
            position = [*circles[i, :2].tolist(), 0.5 * self._world.height]
            bullet.resetBasePositionAndOrientation(mover, position, [0.0, 0.0, 0.0, 1.0], physicsClientId=client)
            velocity = [*velocities[i, :2].tolist(), 0.0]
            bullet.resetBaseVelocity(mover, velocity, [0.0] * 3, physicsClientId=client)


class BulletSimulator:
    """A robot in a world, moved by PyBullet: a team of one."""

    def __init__(self, robot: RobotParams, control_period: float) -> None:
        self._team = BulletTeam(robot, control_period, 1)

    @property
    def state(self) -> TrueState:
        """The truth after the last `reset` or `step`."""
        return self._team.states[0]

    @property
    def tilt(self) -> tuple[float, float]:
        """Roll and pitch of the body [rad]."""
        return self._team.robots[0].tilt

    def reset(self, world: World, pose: Pose2D, rng: np.random.Generator) -> Reading:
        """Put the robot at rest at `pose` (world frame) and return its first reading.

        Raises:
            ValueError: the robot does not fit there.
        """
        return self._team.reset(world, [pose], [rng])[0]

    def step(self, command: Twist) -> Reading:
        """Drive with the commanded twist for one control period and return what the sensors say at its end.

        Raises:
            ValueError: the command holds NaN or infinity.
            RuntimeError: there was no reset.
        """
        return self._team.step([command])[0]

    def close(self) -> None:
        """Disconnect from PyBullet. The next reset connects again."""
        self._team.close()

"""Robots as rigid bodies in PyBullet, driven by the motors of their two wheels."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from envs.geometry import Pose2D
from envs.robots import RobotParams
from envs.worlds import World

from .bullet_bodies import build_world
from .bullet_client import BulletClient, import_pybullet
from .bullet_robot import BulletRobot
from .contact import check_starts
from .drive import check_commands, check_number
from .records import robot_record
from .sensors import TOUCHED, Sensors
from .simulator import Reading, RobotState, Twist
from .state import STATE_SIZE, robot_states

GRAVITY = 9.81
"""Acceleration of gravity [m/s2]."""
SOLVER_ITERATIONS = 15
"""Iterations of the constraint solver in a substep."""
CONTACT_BREAKING = 0.1
"""Distance at which a contact begins and ends, as a fraction of the smaller shape's size. At PyBullet's 0.02 wheels
drag old points of contact along, which costs time, and robots meet walls too late to stop before them."""


class BulletSimulator:
    """Robots in a world, moved by PyBullet; one physics client of its own, opened at the first reset.

    The lidar of each sees the others as circles, as under the kinematic physics.
    """

    def __init__(self, robot: RobotParams, control_period: float, num_robots: int = 1) -> None:
        import_pybullet()
        self._arguments = robot, float(control_period), num_robots
        self._radius, self._period = robot.radius, float(control_period)
        self._substeps = int(robot_record(robot, control_period).substeps)
        self._rows = np.zeros((num_robots, STATE_SIZE))
        self._sensors = Sensors(robot, control_period, num_robots)
        self.robots = [BulletRobot(robot, control_period, row) for row in self._rows]
        self._bullet: Any = None
        self._world: World
        self._rngs: Sequence[np.random.Generator] = ()
        self._steps = -1

    def __reduce__(self) -> tuple[type["BulletSimulator"], tuple[RobotParams, float, int]]:
        """Pickle as a new simulator: what happens in PyBullet stays there."""
        return BulletSimulator, self._arguments

    @property
    def states(self) -> list[RobotState]:
        """Ground truth of each robot; see `Simulator`."""
        self._require_reset()
        return robot_states(self._rows)

    def reset(self, world: World, poses: Sequence[Pose2D], rngs: Sequence[np.random.Generator]) -> list[Reading]:
        """Place the robots at rest and return their first readings; see `Simulator`."""
        check_number(len(self.robots), poses=poses, rngs=rngs)
        check_starts(poses, self._radius, world)
        if self._bullet is None:
            self._bullet = BulletClient()
        if self._steps < 0 or world is not self._world:
            self._build(world)
        self._circles, self._rngs, self._steps = world.circles_at(0.0), rngs, 0
        self._place_movers(self._circles, np.zeros_like(self._circles))
        for robot, pose in zip(self.robots, poses, strict=True):
            robot.move_away(pose)
        self._bullet.performCollisionDetection()
        for robot, pose in zip(self.robots, poses, strict=True):
            robot.reset_pose(pose)
        self._sensors.draw(rngs)
        self._sensors.draw_biases(self._rows)
        return self._sense()

    def step(self, commands: Sequence[Twist]) -> list[Reading]:
        """Drive for one control period; see `Simulator`."""
        self._require_reset()
        check_number(len(self.robots), commands=commands)
        checked = check_commands(commands)
        self._sensors.draw(self._rngs)
        for robot, command, normals in zip(self.robots, checked, self._sensors.draws, strict=True):
            robot.plan(command, normals)
        self._steps += 1
        before, period, substeps = self._circles, self._period, self._substeps
        if self._world.movers:
            self._circles = self._world.circles_at(self._steps * period)
        for substep in range(substeps):
            if self._world.movers:
                travel = self._circles - before
                self._place_movers(before + substep / substeps * travel, travel / period)
            for robot in self.robots:
                robot.turn_wheels(substep)
            self._bullet.stepSimulation()
            for robot in self.robots:
                robot.update_contacts()
        for robot in self.robots:
            robot.update_state()
        return self._sense()

    def close(self) -> None:
        """Disconnect from PyBullet. The next reset connects again."""
        if self._bullet is not None:
            self._bullet.close()
        self._bullet, self._steps = None, -1

    def _sense(self) -> list[Reading]:
        self._sensors.others[:, TOUCHED] = [robot.touched for robot in self.robots]
        self._sensors.sense(self._rows, self._world.segments, self._circles)
        return self._sensors.readings(self._steps * self._period)

    def _require_reset(self) -> None:
        if self._steps < 0:
            raise RuntimeError("call reset before step")

    def _build(self, world: World) -> None:
        bullet = self._bullet
        bullet.resetSimulation()
        bullet.setPhysicsEngineParameter(
            fixedTimeStep=self._period / self._substeps,
            numSubSteps=0,
            numSolverIterations=SOLVER_ITERATIONS,
            contactBreakingThreshold=CONTACT_BREAKING,
            enableConeFriction=0,  # with it the pushing wheels of a robot held by a wall turn it on the spot
            deterministicOverlappingPairs=1,
        )
        bullet.setGravity(0.0, 0.0, -GRAVITY)
        self._movers = build_world(bullet, world)
        for robot in self.robots:
            robot.build(bullet)
        self._world = world

    def _place_movers(self, circles: np.ndarray, velocities: np.ndarray) -> None:
        for i, mover in enumerate(self._movers, start=len(circles) - len(self._movers)):
            position = [*circles[i, :2].tolist(), 0.5 * self._world.height]
            self._bullet.resetBasePositionAndOrientation(mover, position, [0.0, 0.0, 0.0, 1.0])
            velocity = [*velocities[i, :2].tolist(), 0.0]
            self._bullet.resetBaseVelocity(mover, velocity, [0.0] * 3)

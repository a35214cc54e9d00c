"""Physics with PyBullet: robots as rigid bodies with motor-driven wheels."""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.worlds import World

from .bullet_robot import BulletRobot
from .bullet_world import BulletClient, NearbyWalls, build_world, has_many_walls, import_pybullet
from .crowd.step import step_people
from .mover import Simulator
from .records import TOUCHED_PERSON, robot_record

GRAVITY = 9.81
SOLVER_ITERATIONS = 15
CONTACT_BREAKING = 0.1
"""Distance above which PyBullet drops a contact point, divided by the size of the smaller shape."""


class BulletSimulator(Simulator):
    """Simulator that moves robots as rigid bodies in PyBullet."""

    is_copy = False
    _bullet: Any = None
    _nearby: NearbyWalls | None = None
    _people: Sequence[int] = ()

    def __init__(self, *arguments: Any) -> None:
        import_pybullet()
        super().__init__(*arguments)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), self._arguments, {"is_copy": self.is_copy or self._world is not None}

    def set_robot(self, robot: RobotParams) -> None:
        super().set_robot(robot)
        self._arguments = robot, self._period, len(self.rows.numbers), self.crowd.params
        self._substeps = int(robot_record(robot, self._period).substeps)
        fastest = robot.max_v * robot.drive.wheel_radius / robot.odometry.wheel_radius
        self._reach = 2.0 * (robot.radius + fastest * self._period)
        self.robots = [BulletRobot(robot, self._period, row) for row in self.rows.numbers]
        self._built: World | None = None

    def close(self) -> None:
        if self._bullet is not None:
            self._bullet.close()
        self._bullet = self._built = self._world = self._nearby = None

    def _place(self, world: World, poses: Sequence[Pose2D]) -> None:
        self.is_copy = False
        if self._bullet is None:
            self._bullet = BulletClient()
        if world is not self._built or self._nearby is not None or len(self._people) != len(self.crowd.rows):
            self._build(world)
        self._place_people()
        if self._nearby is not None:
            self._nearby.follow(np.array([pose[:2] for pose in poses], dtype=np.float64))
        for robot, pose in zip(self.robots, poses, strict=True):
            robot.move_away(pose)
        self._bullet.performCollisionDetection()
        for robot, pose in zip(self.robots, poses, strict=True):
            robot.reset_pose(pose)

    def _move(self, world: World) -> None:
        rows, numbers = self.rows, self.rows.numbers
        rows.tick()
        numbers["touched"] = 0.0
        if len(self.crowd.rows):
            step_people(*self.crowd.arrays, numbers)
            self._place_people()
        for robot, row, draws in zip(self.robots, numbers, rows.draws, strict=True):
            robot.plan(row["command"], draws[int(row["draw"])])
        if self._nearby is not None:
            self._nearby.follow(np.stack([numbers["x"], numbers["y"]], axis=1))
        for substep in range(self._substeps):
            for robot in self.robots:
                robot.turn_wheels(substep)
            self._bullet.stepSimulation()
            for robot in self.robots:
                robot.update_contacts()
        for robot, row in zip(self.robots, numbers, strict=True):
            robot.update_state()
            row["touched"] = max(row["touched"], float(bool(robot.touched)))
            for person in robot.touched.intersection(self._people):
                row["touched"] = TOUCHED_PERSON + self._people.index(person)
        self.sense()

    def _reset_world(self) -> World:
        if self._world is None and self.is_copy:
            advice = "reset the copy, or use physics='kinematic'"
            raise gymnasium.error.ResetNeeded(f"physics='bullet' cannot be copied in mid-episode: {advice}")
        return super()._reset_world()

    def _build(self, world: World) -> None:
        bullet = self._bullet
        bullet.resetSimulation()
        bullet.setPhysicsEngineParameter(
            fixedTimeStep=self._period / self._substeps,
            numSubSteps=0,
            numSolverIterations=SOLVER_ITERATIONS,
            contactBreakingThreshold=CONTACT_BREAKING,
            enableConeFriction=0,  # with cone friction, wheels turn a robot that a wall blocks
            deterministicOverlappingPairs=1,
        )
        bullet.setGravity(0.0, 0.0, -GRAVITY)
        self._people = build_world(bullet, world, self.crowd.states[:, 4])
        self._nearby = NearbyWalls(bullet, world, self._reach) if has_many_walls(world) else None
        for robot in self.robots:
            robot.build(bullet, world)
        self._built = world

    def _place_people(self) -> None:
        for body, (x, y, *_) in zip(self._people, self.crowd.states.tolist(), strict=True):
            position = [x, y, 0.5 * self._reset_world().height]
            self._bullet.resetBasePositionAndOrientation(body, position, [0.0, 0.0, 0.0, 1.0])

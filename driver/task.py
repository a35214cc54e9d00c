"""Tasks of environments, without ground truth, for a real robot."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from lidarnaut.envs.files import resolve
from lidarnaut.envs.geometry import ORIGIN, Pose2D
from lidarnaut.envs.ids import find_spec
from lidarnaut.envs.observations.positions import GOAL_MEMORY
from lidarnaut.envs.robot import Robot
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Simulator
from lidarnaut.envs.slam import base_name
from lidarnaut.envs.task import Task
from lidarnaut.envs.tasks.goals import GoalTask
from lidarnaut.envs.tasks.navigate import KnownMapTask
from lidarnaut.envs.tasks.starts import UnknownWorldTask
from lidarnaut.envs.worlds import World

NOWHERE = World("unknown", np.empty((0, 4)), np.empty((0, 3)), (ORIGIN,), (0.0, 0.0, 0.0, 0.0))
"""World without walls, in the place of the true one."""


def task_of(id: str) -> type[Task]:
    """Return a variant of an environment's task whose estimator, observations and goal need no ground truth.

    Raises:
        ValueError: the id is unknown, or the task is not for one robot that explores or drives to goals.
    """
    spec = find_spec(id)
    kind = resolve(spec.kwargs.get("task", "lidarnaut.envs.tasks.explore:Explore"), {}, "task")
    if kind.is_team or not issubclass(kind, UnknownWorldTask | KnownMapTask):
        raise ValueError(f"{id} is not for a single robot: choose a policy of Explore, ReachGoal or Navigate")
    return type(kind.__name__, (WithGoal if issubclass(kind, GoalTask) else OnRobot, kind), {})


class OnRobot:
    """Methods of a task that otherwise read the true world or the true state of the robot."""

    end_reason = None
    slam: Any

    def attach(self, robot: RobotParams, control_period: float, physics: str) -> None:
        if isinstance(self, KnownMapTask):
            if self.map is None or self.localizer == "truth":
                raise ValueError("a task on a known map needs the argument map, and localizer 'amcl' or 'odometry'")
            if self.initial_pose == "known":
                self.initial_pose = "unknown"
        elif base_name(self.slam) == "truth":
            raise ValueError("slam must not be 'truth' on a robot")
        super().attach(robot, control_period, physics)  # type: ignore[misc]

    def draw_world(self, world: Any, rng: np.random.Generator) -> World:
        return NOWHERE

    def choose_starts(self, world: World, start: Any, rng: np.random.Generator) -> Sequence[Pose2D]:
        self.starts, self.map_pose = [ORIGIN], ORIGIN
        return self.starts

    def reset(
        self, simulator: Simulator, robots: Sequence[Robot], rng: np.random.Generator, options: Mapping[str, Any]
    ) -> float:
        (self._one,) = robots
        return math.inf

    def update(self, simulator: Simulator, robots: Sequence[Robot], period: float) -> None:
        """Do nothing: a real robot has no reward."""

    def quantities(self) -> dict[str, float]:
        return {}

    def metrics(self) -> dict[str, Any]:
        return {}


class WithGoal(OnRobot):
    """Methods of a task with a goal, which need not be reachable on the true map."""

    has_goal = False
    """Whether a goal has been set; before, it is the origin of the map frame."""
    _read_goal: Any
    _tolerance: Any
    _goals: np.ndarray | None = None

    def reset(
        self, simulator: Simulator, robots: Sequence[Robot], rng: np.random.Generator, options: Mapping[str, Any]
    ) -> float:
        self._goals, self._aim = simulator.rows.remember(GOAL_MEMORY, 2), ORIGIN
        if not self.has_goal:
            self.goal = ORIGIN
        self._goals[0] = self.goal[:2]
        return super().reset(simulator, robots, rng, options)

    def set_goal(self, goal: Sequence[float]) -> float:
        self.goal, self.heading_tolerance = self._read_goal(goal), self._tolerance(len(goal) > 2)
        self.has_goal = True
        if self._goals is not None:
            self._goals[0] = self.goal[:2]
        return math.inf

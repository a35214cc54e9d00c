"""The step of an environment up to what its robots' scans tell: physics, sensors, odometry, predicted poses."""

from collections.abc import Sequence

from envs.geometry import Pose2D
from envs.ground_truth import GroundTruth
from envs.robot import Robot
from envs.simulation import KinematicSimulator, Reading, Simulator, Twist
from envs.simulation import state as at
from envs.simulation.base import BaseSimulator
from envs.simulation.rows import Rows

from .kernels import update_robots


class Transition:
    """Steps a simulator and its robots, whose readings, poses and true states are views of the same rows."""

    def __init__(self, simulator: Simulator, robots: Sequence[Robot]) -> None:
        """Take a simulator of the robots, the user's own as well."""
        self._simulator, self._robots = simulator, robots
        self._begin_rows()

    @property
    def why_not_fused(self) -> str:
        """Why kernels cannot step many such environments together; empty where they can."""
        kind = type(self._simulator)
        return "" if kind is KinematicSimulator else f"{kind.__name__} steps in Python"

    def begin(self, readings: Sequence[Reading], map_pose: Pose2D) -> list[GroundTruth]:
        """Begin an episode once the simulator has been reset; the robots are reset afterwards.

        Args:
            readings: the first ones.
            map_pose: pose of the map frame in the world.

        Returns:
            The true course of each robot.
        """
        self._begin_rows()
        if not isinstance(self._simulator, BaseSimulator):
            self.rows.reset()
            self._load(readings)
        self.rows.numbers[:, at.MAP_POSE : at.MAP_POSE + 3] = map_pose
        return [GroundTruth(self.rows, k) for k in range(len(self._robots))]

    def move(self, commands: Sequence[Twist]) -> None:
        """Drive for one control period, up to what `FLAGS` of the rows then asks for."""
        simulator = self._simulator
        if isinstance(simulator, BaseSimulator):
            simulator.move(commands)
        else:
            self.rows.numbers[:, at.COMMAND_V : at.COMMAND_W + 1] = commands
            self._load(simulator.step(commands))
        update_robots(self.rows.numbers)

    def _load(self, readings: Sequence[Reading]) -> None:
        """Take over what a simulator without rows reports."""
        for k, (reading, state) in enumerate(zip(readings, self._simulator.states, strict=True)):
            self.rows.load(k, reading, state)
            self._robots[k].reading = reading

    def _begin_rows(self) -> None:
        simulator, robots = self._simulator, self._robots
        if isinstance(simulator, BaseSimulator):
            self.rows = simulator.rows
        elif not hasattr(self, "rows"):
            self.rows = Rows(robots[0].params, robots[0].control_period, len(robots))
        for k, robot in enumerate(robots):
            robot.rows, robot.index = self.rows, k

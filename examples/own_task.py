"""Custom task: drive to a goal in an unknown world. See docs/guides/customize/task.md."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import gymnasium
import numpy as np
import tyro

from lidarnaut import register
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.observations import Goal
from lidarnaut.envs.robot import Robot
from lidarnaut.envs.simulation import Simulator
from lidarnaut.envs.tasks.goals import GeodesicDistance, draw_goal
from lidarnaut.envs.measures import GOAL
from lidarnaut.envs.tasks.starts import UnknownWorldTask


@dataclass(kw_only=True, eq=False)
class ReachGoal(UnknownWorldTask):
    """Drive to a goal in the map frame, which is the robot's start pose."""

    measures = GOAL
    progress = "progress"
    weights = {"progress": 1.0, "time": -0.02, "collision": -0.5, "reached": 10.0}
    goal_tolerance: float = 0.3

    def observation_parts(self) -> Mapping[str, Any]:
        """Return the goal relative to the estimated pose."""
        return {"goal": partial(Goal, self)}

    def reset(
        self, simulator: Simulator, robots: Sequence[Robot], rng: np.random.Generator, options: Mapping[str, Any]
    ) -> float:
        """Sample a goal and return the time limit [s]."""
        goal = draw_goal(self.area, self.starts[0], rng)  # world frame
        self.goal: Pose2D = self.map_pose.between(goal)
        self._distance = GeodesicDistance(self.area, goal)
        self._shortest = self._left = self._distance.length(self.starts[0])
        return 30.0 + 4.0 * self._left / self.robot.max_v

    def quantities(self) -> dict[str, float]:
        """Return the rewarded quantities of a control period, in addition to `time` and `collision`."""
        before, self._left = self._left, self._distance.length(self.simulator.states[0].pose)
        return {"progress": before - self._left, "reached": float(self._left <= self.goal_tolerance)}

    @property
    def end_reason(self) -> str | None:
        """Reason why the episode has ended, or None."""
        return "reached" if self._left <= self.goal_tolerance else None

    def metrics(self) -> dict[str, Any]:
        """Return the entries of `info`."""
        share = 1.0 - self._left / max(self._shortest, self._left, 1e-9)
        return {"geodesic_distance": self._left, "progress": share, "is_success": self.end_reason is not None}


register("own_task/ReachGoal-v0", "own_task:ReachGoal", world="rooms")


def main(seconds: float = 30.0) -> dict[str, Any]:
    """Drive straight towards the goal, ignoring obstacles, and return the last `info`."""
    env = gymnasium.make("own_task/ReachGoal-v0", physics="kinematic")
    observation, info = env.reset(seed=0)
    while info["time"] < seconds and not info["is_success"]:
        _, ahead, left, *_ = observation["goal"]
        observation, *_, info = env.step(np.array([max(ahead, 0.0), left], dtype=np.float32))
    env.close()
    print(f"{info['geodesic_distance']:.1f} m to go after {info['time']:.0f} s")
    return info


if __name__ == "__main__":
    tyro.cli(main)

"""The known map, the localizer, goals and the true distance to them."""

import math
from typing import Any

import numpy as np

from envs.estimation import ORIGIN, Belief, Estimator
from envs.geometry import FREE, OCCUPIED, UNKNOWN, OccupancyGrid, Pose2D
from envs.localization import Amcl, AmclParams, load_preset
from envs.navigation import COST_FREE, COST_LETHAL, Costmap, CostmapParams, TravelField, travel_field
from envs.robots import LidarParams
from envs.simulation import Reading
from envs.worlds import ExplorableArea

LOCALIZERS = ("amcl", "odometry", "truth")
"""Names of the localizers. "odometry" and "truth" add up the motions that they are given, from the true start."""
MIN_DISTANCE = 1.0
"""Least distance from the start to a random goal [m]."""


class DeadReckoning:
    """An `Estimator` on a known map that adds up motions and looks at no scan."""

    uses_first_scan = False
    belief: Belief

    def reset(
        self, rng: np.random.Generator, pose: Pose2D | None = ORIGIN, map: Any = None, covariance: Any = None
    ) -> Belief:
        """Start at a pose, ValueError without one; see `Estimator`."""
        if pose is None:
            raise ValueError("dead reckoning needs to know where the robot starts; take localizer='amcl'")
        self.belief = Belief(pose, map)
        return self.belief

    def update(self, reading: Reading, motion: Pose2D) -> Belief:
        """Follow a motion; see `Estimator`."""
        self.belief.pose = self.belief.pose.compose(motion)
        return self.belief


def make_localizer(name: str, lidar: LidarParams, preset: str | AmclParams) -> Estimator:
    """Return a localizer by its name; ValueError if this or the preset of AMCL is unknown."""
    if name not in LOCALIZERS:
        raise ValueError(f"unknown localizer {name!r}; choose one of {', '.join(LOCALIZERS)}")
    return Amcl(lidar, load_preset(preset)) if name == "amcl" else DeadReckoning()


def known_map(area: ExplorableArea) -> OccupancyGrid:
    """Return the map that a perfect exploration would leave: free where one can see, walls, and all else unknown."""
    walls = area.walls
    data = np.where(area.explorable, np.int8(FREE), np.int8(UNKNOWN))
    data[walls.data > 0] = OCCUPIED
    return OccupancyGrid(data, walls.resolution, walls.origin)


class GeodesicDistance:
    """True distance to a goal around everything that does not move."""

    def __init__(self, area: ExplorableArea, goal: Pose2D) -> None:
        """Measure distances from free space to a goal, world frame; ValueError if the robot does not fit there."""
        if not area.is_traversable(goal):
            raise ValueError(f"goal {tuple(goal)} (world frame) is no pose that the robot can reach")
        costs = np.where(area.traversable, np.uint8(COST_FREE), np.uint8(COST_LETHAL))
        resolution = area.walls.resolution
        costmap = Costmap(costs, area.walls, CostmapParams(resolution, resolution))
        field = travel_field(costmap, goal[:2], cost_weight=0.0)
        assert field is not None
        self._field: TravelField = field
        self._last = math.inf

    def length(self, pose: Pose2D) -> float:
        """Return the distance from a pose (world frame) to the goal [m]; where the robot does not fit, the last one."""
        walls = self._field.costmap.grid
        cell = walls.cells(np.array(pose[:2]))
        if walls.contains(cell):
            length = float(self._field.cost(cell))
            self._last = length if math.isfinite(length) else self._last
        return self._last


def draw_goal(area: ExplorableArea, start: Pose2D, rng: np.random.Generator) -> Pose2D:
    """Draw a collision-free goal (world frame), at least `MIN_DISTANCE` from the start in a straight line.

    In a world too small for that, the farthest of a hundred.
    """
    drawn: list[Pose2D] = []
    away = [0.0]
    while away[-1] < MIN_DISTANCE and len(drawn) < 100:
        drawn.append(area.draw_pose(rng))
        away.append(math.dist(drawn[-1][:2], start[:2]))
    return drawn[max(int(np.argmax(away)) - 1, 0)]

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from lidarnaut.envs.arguments import is_pose
from lidarnaut.envs.estimation import Estimator
from lidarnaut.envs.estimation.dead_reckoning import DeadReckoning
from lidarnaut.envs.geometry import FREE, OCCUPIED, UNKNOWN, OccupancyGrid, Pose2D
from lidarnaut.envs.localization import Amcl, AmclParams, load_preset
from lidarnaut.envs.robot import Prior
from lidarnaut.envs.robots import LidarParams, RobotParams
from lidarnaut.envs.worlds import ExplorableArea, load_map

from .starts import WorldTask

LOCALIZERS = ("amcl", "odometry", "truth")
"""Names of localizers. "odometry" and "truth" integrate measured or true motion from the true start."""
INITIAL_STD, INITIAL_STD_THETA = 0.1, math.radians(5.0)
"""Standard deviations of the localizer's initial pose: position along an axis [m], heading [rad]."""


@dataclass(kw_only=True, eq=False)
class KnownMapTask(WorldTask):
    """Base class of tasks with a known map: a localizer estimates the pose."""

    localizer: str = "amcl"
    amcl: str | AmclParams = "default"
    initial_pose: Literal["known", "unknown"] = "known"
    map: str | Path | OccupancyGrid | None = None
    map_pose: Any = (0.0, 0.0, 0.0)

    def attach(self, robot: RobotParams, control_period: float, physics: str) -> None:
        if self.initial_pose not in ("known", "unknown"):
            raise ValueError(f"initial_pose must be 'known' or 'unknown', got {self.initial_pose!r}")
        if self.initial_pose == "unknown" and self.localizer != "amcl":
            raise ValueError(f"initial_pose='unknown' needs localizer='amcl', got {self.localizer!r}")
        if not is_pose(self.map_pose):
            raise ValueError(f"map_pose must be (x, y, theta), got {self.map_pose!r}")
        self.map_pose = Pose2D(*map(float, self.map_pose))
        self._map = load_map(self.map) if isinstance(self.map, str | Path) else self.map
        self.needs_explorable = self._map is None
        self.uses_true_motion = self.localizer == "truth"
        super().attach(robot, control_period, physics)

    def make_estimator(self) -> Estimator:
        return make_localizer(self.localizer, self.robot.lidar, self.amcl)

    def prior(self, index: int, rng: np.random.Generator) -> Prior:
        grid = known_map(self.area) if self._map is None else self._map
        if self.initial_pose == "unknown":
            return Prior(None, grid)
        pose = self.map_pose.between(self.starts[0])
        std = np.array([INITIAL_STD, INITIAL_STD, INITIAL_STD_THETA])
        prior_pose = Pose2D(*(pose + std * rng.standard_normal(3)))
        cell = grid.cells(np.array(prior_pose[:2]))
        if self.localizer != "amcl" or not grid.contains(cell) or grid.data[tuple(cell)] != 0:
            prior_pose = pose
        return Prior(prior_pose, grid, np.diag(std**2))


def make_localizer(name: str, lidar: LidarParams, preset: str | AmclParams) -> Estimator:
    """Create a localizer; ValueError for an unknown name or AMCL preset."""
    if name not in LOCALIZERS:
        raise ValueError(f"unknown localizer {name!r}; choose one of {', '.join(LOCALIZERS)}")
    return Amcl(lidar, load_preset(preset)) if name == "amcl" else DeadReckoning()


def known_map(area: ExplorableArea) -> OccupancyGrid:
    """Return the map of a perfect exploration: all that the lidar can see."""
    walls = area.walls
    data = np.where(area.explorable, np.int8(FREE), np.int8(UNKNOWN))
    data[walls.data > 0] = OCCUPIED
    return OccupancyGrid(data, walls.resolution, walls.origin)

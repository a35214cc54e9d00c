"""Scenes: the content of a picture."""

import math
from dataclasses import dataclass

import numpy as np

from envs.geometry import OccupancyGrid, Pose2D
from envs.robots import RobotParams
from envs.slam import Belief, PoseGraphView
from envs.worlds import World


@dataclass(slots=True, kw_only=True)
class Moment:
    """What all scenes show of a moment of an episode."""

    world: World
    robot: RobotParams
    pose: Pose2D
    """True pose of the robot's base."""
    trail: np.ndarray
    """True positions so far, shape (n, 2), in the frame of `pose` [m]."""
    ranges: np.ndarray
    """Last scan, shape (num_beams,), float32 [m], as `Reading.ranges`."""
    plan: np.ndarray | None
    """Planned path, shape (n, 2), map frame [m]; None without one."""
    time: float
    """Time since the reset [s]."""
    collisions: int
    """Contacts so far."""


@dataclass(slots=True, kw_only=True)
class Scene(Moment):
    """One moment of exploration: the ground truth in the world frame, and the robot's map and pose estimate."""

    start: Pose2D
    """World pose of the map frame's origin: `start.compose` carries poses of the map frame into the world frame."""
    belief: Belief
    """Pose estimate and map, map frame."""
    estimated_trail: np.ndarray
    """Estimated positions so far, shape (n, 2), map frame [m]."""
    explored_fraction: float
    """Explored share of the explorable area, from 0 to 1."""
    pose_graph: PoseGraphView | None = None
    """Nodes and loop closures of a SLAM that has any."""
    peers: tuple["Scene", ...] = ()
    """The other robots of the team, which share world and map."""

    @property
    def estimated_pose(self) -> Pose2D:
        """Estimated pose of the robot's base, world frame."""
        return self.start.compose(self.belief.pose)

    @property
    def pose_error(self) -> tuple[float, float]:
        """Distance [m] and angle [rad] between estimated and true pose, not negative; the greatest of all robots."""
        errors = [scene.estimated_pose.between(scene.pose) for scene in (self, *self.peers)]
        return max(math.hypot(error.x, error.y) for error in errors), max(abs(error.theta) for error in errors)


@dataclass(slots=True, kw_only=True)
class NavigationScene(Moment):
    """One moment of a drive over a known map. All poses lie in the map's frame."""

    estimated_pose: Pose2D
    """Estimated pose of the robot's base."""
    is_lost: bool
    """Whether the localizer reports that its estimate has diverged."""
    particles: np.ndarray
    """Particles of the localizer, shape (n, 3): x, y, heading [m, m, rad]; n is 0 for localizers without."""
    grid: OccupancyGrid
    """The map."""
    goal: Pose2D | None
    """Where to go; None without a goal."""

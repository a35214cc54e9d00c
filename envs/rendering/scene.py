"""What there is to draw."""

import math
from dataclasses import dataclass

import numpy as np

from envs.geometry import OccupancyGrid, Pose2D
from envs.robots import RobotParams
from envs.slam import Belief
from envs.worlds import World


@dataclass(slots=True)
class Scene:
    """One moment of an episode, as it truly is and as the robot believes it to be."""

    world: World
    """The place."""
    robot: RobotParams
    """The robot."""
    pose: Pose2D
    """True pose of the robot's base, world frame."""
    start: Pose2D
    """World pose of the map frame's origin: `start.compose` carries what is believed into the world frame."""
    belief: Belief
    """Believed pose and map, map frame."""
    ranges: np.ndarray
    """Last scan, shape (num_beams,), float32 [m], as `Reading.ranges`."""
    trail: np.ndarray
    """True positions so far, shape (n, 2), world frame [m]."""
    believed_trail: np.ndarray
    """Believed positions so far, shape (n, 2), map frame [m]."""
    plan: np.ndarray | None
    """Planned path, shape (n, 2), map frame [m]; None without one."""
    explored_fraction: float
    """Explored share of the explorable area, from 0 to 1."""
    time: float
    """Time since the reset [s]."""
    collisions: int
    """Contacts so far."""
    mates: tuple["Scene", ...] = ()
    """The same of the other robots that share the place and the map."""

    @property
    def believed_pose(self) -> Pose2D:
        """Where the robot believes to be, world frame."""
        return self.start.compose(self.belief.pose)

    @property
    def pose_error(self) -> tuple[float, float]:
        """Distance [m] and angle [rad] between the believed and the true pose, both at least 0; the greatest of all."""
        errors = [scene.believed_pose.between(scene.pose) for scene in (self, *self.mates)]
        return max(math.hypot(error.x, error.y) for error in errors), max(abs(error.theta) for error in errors)


@dataclass(slots=True)
class NavigationScene:
    """One moment of a drive over a known map. All poses lie in the map's frame."""

    world: World
    """The place, for its name."""
    robot: RobotParams
    """The robot."""
    pose: Pose2D
    """True pose of the robot's base."""
    believed_pose: Pose2D
    """Where the localiser takes it to be."""
    is_lost: bool
    """Whether the localiser says that this must not be trusted."""
    particles: np.ndarray
    """Shape (n, 3): x, y, heading; empty for localisers without."""
    grid: OccupancyGrid
    """The map."""
    ranges: np.ndarray
    """Last scan, shape (num_beams,), float32 [m], as `Reading.ranges`."""
    trail: np.ndarray
    """True positions so far, shape (n, 2) [m]."""
    goal: Pose2D | None
    """Where to go; None without a goal."""
    plan: np.ndarray | None
    """Planned path, shape (n, 2) [m]; None without one."""
    time: float
    """Time since the reset [s]."""
    collisions: int
    """Contacts so far."""

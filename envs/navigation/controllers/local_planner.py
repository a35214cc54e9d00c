import numpy as np

from lidarnaut.envs.estimation.scan_points import without_bodies
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.geometry.distance_transform import squared_distances
from lidarnaut.envs.simulation import Twist

NO_TRACKS = np.empty((0, 5))


class LocalPlanner:
    """Base of local planners, which follow one path at a time. Subclasses define `command`.

    Constructed with robot, control period [s] and random generator.
    """

    turns_at_goal: bool = False
    """Whether `set_path` has further arguments: heading [rad], None for any, and tolerance [m] of the goal."""
    blocked: bool = False
    """True if obstacles prevented forward motion in the last command."""
    tracks: np.ndarray = NO_TRACKS
    """Tracked people, as `PeopleTracker.people`. The navigator sets it before `command`."""
    _path: np.ndarray = np.empty((0, 2))
    _index: int = 0

    @property
    def remaining(self) -> np.ndarray:
        """Remaining path, shape (n, 2), map frame [m]."""
        return self._path[self._index :]

    def set_path(self, path: np.ndarray) -> None:
        """Set the path: shape (n, 2), n > 0, map frame [m]."""
        self._path, self._index = np.ascontiguousarray(path), 0

    def command(self, pose: Pose2D, twist: Twist, obstacles: np.ndarray) -> Twist:
        """Return the next velocity command.

        `pose`: pose estimate, map frame. `twist`: current velocity. `obstacles`: points, shape (n, 2), base frame [m],
        so that stops do not depend on the pose estimate.
        """
        raise NotImplementedError(f"{type(self).__name__} must define command(pose, twist, obstacles)")

    def _squared_gaps(self, obstacles: np.ndarray, side: int, resolution: float, reach: int) -> np.ndarray:
        """Return squared distances to obstacles, without tracked people, shape (side, side), uint16 [cells2].

        The raster has cells of `resolution` [m]. Distances are exact up to `reach` cells.
        """
        cells = np.floor(without_bodies(obstacles, self.tracks) / resolution + 0.5 * side).astype(np.int64)
        cells = cells[((cells >= 0) & (cells < side)).all(axis=1)]
        is_occupied = np.zeros((side, side), dtype=np.bool_)
        is_occupied[cells[:, 1], cells[:, 0]] = True
        return squared_distances(is_occupied, reach)

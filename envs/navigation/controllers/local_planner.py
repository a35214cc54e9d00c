import numpy as np

from lidarnaut.envs.geometry import Pose2D
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

"""Ground truth as a motion source, for mapping without drift."""

from collections.abc import Callable

from envs.geometry import Pose2D
from envs.simulation import Reading


class TrueMotion:
    """A `MotionSource` that returns the true motion of the base."""

    def __init__(self, true_pose: Callable[[], Pose2D]) -> None:
        """Take what returns the true pose of the base at the last reading, world frame."""
        self._true_pose = true_pose
        self._last = Pose2D(0.0, 0.0, 0.0)

    def reset(self, reading: Reading) -> None:
        """Start at the pose of the moment."""
        self._last = self._true_pose()

    def update(self, reading: Reading) -> Pose2D:
        """Return the pose of the base now, seen from the base at the last reading."""
        before, self._last = self._last, self._true_pose()
        return before.between(self._last)

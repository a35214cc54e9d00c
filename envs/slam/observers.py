"""Watching the scan matcher at work."""

from typing import Protocol

from envs.geometry import Pose2D


class MatcherObserver(Protocol):
    """Is notified of every pose that the matcher tests. Costs are hits minus the sum of their cells' occupancies."""

    def on_matching_start(self, pose: Pose2D) -> None:
        """A search begins at the predicted pose."""
        ...

    def on_scan_test(self, pose: Pose2D, cost: float) -> None:
        """A pose was tested, be it the predicted one."""
        ...

    def on_pose_update(self, pose: Pose2D, cost: float) -> None:
        """A pose was better than all before it."""
        ...

    def on_matching_end(self, pose: Pose2D, cost: float) -> None:
        """The search ended with this pose."""
        ...

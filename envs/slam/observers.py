"""Watching the scan matcher at work."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from envs.geometry import Pose2D, wrap_angle

from .cells import ONE
from .grid_map import GridMap
from .matcher import Search, SearchParams, draw_candidate, judge_candidate, penalty, score


class MatcherObserver(Protocol):
    """Is notified of every pose that the matcher tests. Costs are hits minus the sum of their cells' occupancies.

    With a prior, plus what it takes off.
    """

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


def match_observed(
    observers: Sequence[MatcherObserver],
    grid_map: GridMap,
    points: np.ndarray,
    num_points: int,
    predicted: Pose2D,
    params: SearchParams,
    noise: np.ndarray,
) -> Search:
    """Do what `match` does, by the same steps, and tell observers of each; `predicted` is in metres."""
    indices = np.empty(points.shape[1], dtype=np.uint32)
    x, y = grid_map.to_cells(predicted.x, predicted.y)
    start = (x, y, predicted.theta)

    def tell(event: str, *said: Pose2D | float) -> None:
        for observer in observers:
            getattr(observer, event)(*said)

    def test(x: float, y: float, theta: float, pose: Pose2D) -> int:
        total = score(grid_map.words, params.unvisited, points, num_points, x, y, theta, indices)
        total -= penalty(params, start, x, y, theta)
        tell("on_scan_test", pose, num_points - total / ONE)
        return total

    tell("on_matching_start", predicted)
    best, search = predicted, Search(x, y, predicted.theta, test(x, y, predicted.theta, predicted))
    while search.failed < params.max_failed and search.tried < params.max_tries:
        x, y, theta = draw_candidate(search, params, noise)
        pose = Pose2D(*grid_map.to_metres(x, y), wrap_angle(theta))
        before, search = search, judge_candidate(search, params, x, y, theta, test(x, y, theta, pose))
        if search.accepted > before.accepted:
            best = pose
            tell("on_pose_update", pose, num_points - search.total / ONE)
    tell("on_matching_end", best, num_points - search.total / ONE)
    return search

"""Which loop closures are searched, and which are believed.

Windows grow with the length of the path through the graph, as the error does, instead of being wide everywhere. What a
search finds must agree with what a submap knows to be free as well. A large correction needs a second witness, since a
wrong one does more harm than a right one that comes a little later.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from envs.geometry import Pose2D, wrap_angle
from envs.geometry.pose import distance
from envs.slam.matching.pyramid import FULL
from envs.slam.matching.submap_field import UNKNOWN_PERCENT


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopClosureParams:
    """Where loop closures are searched and when they are accepted."""

    half_width: float = 0.5
    """Half width of the search window next to the robot [m]."""
    half_width_growth: float = 0.06
    """By how much it grows per metre of path through the graph."""
    max_half_width: float = 4.0
    """Largest half width [m]."""
    half_angle: float = 0.1
    """Half angle of the search window next to the robot [rad]."""
    half_angle_growth: float = 0.015
    """By how much it grows [rad/m]."""
    max_half_angle: float = 0.6
    """Largest half angle [rad]."""
    max_distance: float = 4.0
    """Distance to a node of a submap within which it is searched, without the uncertainty of the pose [m]."""
    min_score: float = 0.4
    """Least mean occupancy of the cells in which hits fall."""
    min_occupied: float = 0.5
    """Least share of hits on or next to occupied cells."""
    max_free: float = 0.15
    """Largest share of hits in free cells away from occupied ones."""
    min_agreement: float = 0.75
    """Least share of hits on or next to occupied cells among those that do not fall into unknown ones."""
    max_unconfirmed: float = 0.25
    """Corrections up to this are taken at once, larger ones when a second one agrees [m]."""
    confirmation_nodes: int = 25
    """Number of nodes within which a second one must come."""
    confirmation_distance: float = 0.2
    """Largest distance between the poses of two corrections that agree [m]."""
    confirmation_angle: float = 0.05
    """Largest angle between them [rad]."""

    def __post_init__(self) -> None:
        for field in ("half_width", "half_angle", "max_half_width", "max_half_angle", "max_distance"):
            if not 0.0 < getattr(self, field) < math.inf:
                raise ValueError(f"{field} must be positive, got {getattr(self, field)!r}")
        for field in ("min_score", "min_occupied", "max_free", "min_agreement"):
            if not 0.0 <= getattr(self, field) <= 1.0:
                raise ValueError(f"{field} must lie in [0, 1], got {getattr(self, field)!r}")


class HitShares(NamedTuple):
    """How the hits of a scan fall on a field."""

    score: float
    """Mean occupancy of the cells; those that are free or unknown count 0."""
    occupied: float
    """Share of hits on or next to an occupied cell."""
    free: float
    """Share of hits in free cells that have no occupied one next to them."""


class Loop(NamedTuple):
    """A loop closure that was found: the pose of a node in a submap."""

    node: int
    submap: int
    relative: Pose2D
    """Pose of the node in the submap's frame."""
    covariance: np.ndarray
    """Shape (3, 3), of `relative`, in the submap's frame [m^2, rad^2]."""
    before: Pose2D
    """Pose of the node by the graph, map frame."""
    after: Pose2D
    """Pose of the node by this closure and the submap's pose by the graph, map frame."""


def search_window(path_length: float, params: LoopClosureParams) -> tuple[float, float]:
    """Return half width [m] and half angle [rad] of the window for a submap so far away along the graph [m]."""
    return (
        min(params.half_width + params.half_width_growth * path_length, params.max_half_width),
        min(params.half_angle + params.half_angle_growth * path_length, params.max_half_angle),
    )


@njit(cache=True, error_model="numpy")
def hit_shares(field, geometry, points, pose):
    """Return the `HitShares` of points at a pose.

    Args:
        field: shape (height, width), uint8 [percent].
        geometry: `FieldGeometry`.
        points: shape (n, 2), float32, hits in the base frame [m].
        pose: x, y, heading in the submap's frame [m, m, rad].
    """
    height, width = field.shape
    x, y = (pose[0] - geometry.x) / geometry.resolution, (pose[1] - geometry.y) / geometry.resolution
    c, s = math.cos(pose[2]) / geometry.resolution, math.sin(pose[2]) / geometry.resolution
    total = occupied = free = 0
    for k in range(points.shape[0]):
        u, v = float(points[k, 0]), float(points[k, 1])
        col, row = math.floor(x + c * u - s * v), math.floor(y + s * u + c * v)
        greatest = np.uint8(0)
        for i in range(max(row - 1, 0), min(row + 2, height)):
            for j in range(max(col - 1, 0), min(col + 2, width)):
                greatest = max(greatest, field[i, j])
        value = field[row, col] if 0 <= row < height and 0 <= col < width else np.uint8(UNKNOWN_PERCENT)
        if greatest > UNKNOWN_PERCENT:
            occupied += 1
            total += int(value) if value > UNKNOWN_PERCENT else 0
        elif value < UNKNOWN_PERCENT:
            free += 1
    n = max(points.shape[0], 1)
    return HitShares(total / (FULL * n), occupied / n, free / n)


def is_accepted(shares: HitShares, params: LoopClosureParams) -> bool:
    """Return whether hits agree well enough with a submap for a loop closure."""
    return (
        shares.score >= params.min_score
        and shares.occupied >= params.min_occupied
        and shares.free <= params.max_free
        and shares.occupied >= params.min_agreement * (shares.occupied + shares.free)
    )


class Confirmation:
    """Holds back large corrections until a second one agrees."""

    def __init__(self, params: LoopClosureParams) -> None:
        """Start with nothing held back."""
        self._params = params
        self._pending: list[Loop] = []

    def add(self, loop: Loop) -> list[Loop]:
        """Return the loop closures that may be added to the graph now: none, this one, or the one before as well."""
        params = self._params
        self._pending = [each for each in self._pending if loop.node - each.node <= params.confirmation_nodes]
        if distance(loop.after.x - loop.before.x, loop.after.y - loop.before.y) <= params.max_unconfirmed:
            return [loop]
        for each in self._pending:
            if each.node != loop.node and self._agree(each, loop):
                self._pending.remove(each)
                return [each, loop]
        self._pending.append(loop)
        return []

    def _agree(self, first: Loop, second: Loop) -> bool:
        """Return whether both closures say the same of the pose at the second one's node."""
        expected = first.after.compose(first.before.between(second.before))
        far = distance(expected.x - second.after.x, expected.y - second.after.y)
        turned = abs(wrap_angle(expected.theta - second.after.theta))
        return far <= self._params.confirmation_distance and turned <= self._params.confirmation_angle

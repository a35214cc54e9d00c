"""Estimates of a robot's pose, with their covariance, and of its map."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from envs.geometry import OccupancyGrid, Pose2D

ORIGIN = Pose2D(0.0, 0.0, 0.0)
"""Pose of a frame in itself."""
NO_CELLS = np.empty((0, 2), dtype=np.int32)
"""`MapUpdate.new_cells` of a scan that made nothing known."""


class Window(NamedTuple):
    """A rectangle of map cells, its last column and row included."""

    col_min: int
    row_min: int
    col_max: int
    row_max: int


class MapUpdate(NamedTuple):
    """How the last scan changed the map."""

    new_cells: np.ndarray
    """Shape (k, 2), int32, (row, column): cells that turned from unknown to known; of a map that was redrawn, all known
    cells. Counted from `origin`."""
    window: Window | None
    """Cells that may have changed; None if the scan was not integrated."""
    redrawn: bool = False
    """Whether the map changed as a whole: a loop was closed, or another particle became the best one."""
    origin: tuple[float, float] = (0.0, 0.0)
    """Position (x, y) of the corner of cell (0, 0) at that time, map frame [m]; a map may grow afterwards."""


NO_UPDATE = MapUpdate(NO_CELLS, None)
"""Of a scan that was not integrated."""


@dataclass(slots=True)
class Belief:
    """Pose estimate and map, in the map frame.

    The same object is updated in place by every scan; copy what must outlive the next one.
    """

    pose: Pose2D
    """Estimated pose of the robot's base."""
    grid: OccupancyGrid
    """The map. The array behind it is live, and is replaced when the map grows."""
    update: MapUpdate = NO_UPDATE
    """What the last scan changed in the map."""
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    """Shape (3, 3), float64: covariance of x, y, heading [m, m, rad]; zeros where the estimator gives none."""
    is_lost: bool = False
    """Whether the pose must not be trusted."""
    path: np.ndarray | None = None
    """Shape (n, 3), float64: with a map that was redrawn, the corrected poses so far, one per scan [m, m, rad]; None
    otherwise."""
    key_poses: np.ndarray | None = None
    """Shape (m, 3), float64: of an estimator that processes key scans alone, with a map that was redrawn, the corrected
    poses of these [m, m, rad]; None otherwise. Trails follow them instead of `path`, whose other poses simulations that
    compose the motions between key scans do not know."""

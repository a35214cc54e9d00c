"""Estimates of a robot's pose and of its map, and the protocol of what makes them: SLAM, localization, mapping."""

from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np
from scipy.spatial import cKDTree

from lidarnaut.envs.files import SHORT
from lidarnaut.envs.geometry import OccupancyGrid, Pose2D
from lidarnaut.envs.simulation import Reading, Twist

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

    def union(self, other: "Window") -> "Window":
        """Return the least window that holds both."""
        return Window(*map(min, self[:2], other[:2]), *map(max, self[2:], other[2:]))


class Correction(NamedTuple):
    """How what a map shows was moved when it was redrawn: by the poses of which it had been seen."""

    before: np.ndarray
    """Shape (n, 3), float64: poses of the past in the map of before [m, m, rad]."""
    after: np.ndarray
    """Shape (n, 3), float64: the same poses in the map that replaces it."""

    def apply(self, points: np.ndarray) -> np.ndarray:
        """Return where points have gone, each with the nearest pose; shape (k, 2), float64, map frame [m]."""
        points = np.asarray(points, dtype=np.float64).reshape(-1, 2)
        if len(self.before) == 0 or len(points) == 0:
            return points.copy()
        _, nearest = cKDTree(self.before[:, :2]).query(points)
        before, after = self.before[nearest], self.after[nearest]
        turn = after[:, 2] - before[:, 2]
        c, s, (x, y) = np.cos(turn), np.sin(turn), (points - before[:, :2]).T
        return after[:, :2] + np.column_stack([c * x - s * y, s * x + c * y])


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
    correction: Correction | None = None
    """Where what the map showed has gone; None unless it was redrawn, or where the estimator cannot tell."""


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
    rivals: np.ndarray = field(default_factory=lambda: np.empty((0, 4)))
    """Shape (k, 4), float64: x, y, heading of other poses that explain the scans as well [m, m, rad], and their weight
    relative to that of `pose`; empty if the pose is unambiguous, or the estimator does not check it."""
    twist: Twist | None = None
    """Estimated velocity of the base; None where the estimator gives none."""
    people: np.ndarray = field(default_factory=lambda: np.empty((0, 5)))
    """People that the robot tracks by its scans, as `PeopleTracker.people`: shape (n, 5), float64, base frame."""
    on_people: np.ndarray | None = None
    """Shape (num_beams,), bool: beams of the last scan that end at people, or at what may be one, which are left out of
    the map; None where nobody is tracked."""
    path: np.ndarray | None = None
    """Shape (n, 3), float64: with a map that was redrawn, the corrected poses so far, one per scan, or one per key scan
    of estimators with an `anchor` [m, m, rad]; None otherwise."""

    @property
    def hypotheses(self) -> np.ndarray:
        """Shape (1 + k, 4), float64: `pose` and its rivals: x, y, heading [m, m, rad], weight; weights sum to 1."""
        rows = np.vstack([(*self.pose, 1.0), self.rivals])
        rows[:, 3] /= rows[:, 3].sum()
        return rows


class Estimator(Protocol):
    """Turns readings and motions into a belief. Constructed with the lidar's geometry and the algorithm's parameters.

    An estimator whose `reset` integrates scans into a map that it is given, and that has this map as `map`, sets
    `shares_maps = True`, and serves several robots with one map. One that looks at scans from the first motion on,
    and not at that of the reset, sets `uses_first_scan = False`. Where a task gives the covariance of the initial pose,
    `reset` gets it as `covariance`, shape (3, 3), float64 [m, m, rad].
    """

    @property
    def belief(self) -> Belief:
        """The current belief."""
        ...

    def reset(self, rng: np.random.Generator, pose: Any = ORIGIN, map: Any = None) -> Belief:
        """Start at a `Pose2D`, map frame, or for None anywhere on a known map; `map` is None for an unknown one."""
        ...

    def update(self, reading: Reading, motion: Pose2D) -> Belief:
        """Process a reading; `motion` is the pose of the base now, seen by odometry from the base at the last one."""
        ...


def check_belief(belief: Any, name: str, grid: OccupancyGrid | None = None, before: Any = (None, None)) -> None:
    """Refuse what the estimator `name` returned if no map can be made of it; kernels check no index.

    It must hold `grid`, if there is one; `before` are the data of the grid before, and their shape then.

    Raises:
        ValueError: a part has the wrong type or shape, is not finite or lies outside of the grid; names the estimator.
    """
    if fault := _fault_of(belief, grid, *before):
        raise ValueError(f"estimator {name}: {fault}")


def _fault_of(belief: Any, grid: Any, old_data: Any, old_shape: Any) -> str:
    if not isinstance(belief, Belief):
        return f"it must return a Belief, got {belief!r}"
    data, start, path = belief.grid.data, belief.grid.origin, () if belief.path is None else belief.path
    cells, window, _, origin, _ = belief.update
    if (grid is not None and belief.grid is not grid) or (data is old_data and data.shape != old_shape):
        return "grid must be one OccupancyGrid for all robots of an episode, with other data where their shape changes"
    if data.ndim != 2 or data.dtype != np.int8:
        return f"grid.data must be a 2D int8 array, got {data.ndim}D {data.dtype}"
    if not (np.isfinite([*belief.pose, *start, *origin]).all() and np.isfinite(path).all()):
        return f"pose, origins and path must be finite, got {belief.pose}, {start}, {origin} and {path}"
    size = "the grid has {} rows and {} columns".format(*data.shape)
    left, low, right, high = sides = np.asarray((0, 0, 0, 0) if window is None else window)
    if sides.dtype.kind not in "iu" or not (0 <= left <= right < data.shape[1] and 0 <= low <= high < data.shape[0]):
        return f"{window} is no window of cells; {size}"
    if not (isinstance(cells, np.ndarray) and cells.dtype.kind in "iu" and cells.ndim == 2 and cells.shape[1] == 2):
        return f"new_cells must be an array of integers, shape (k, 2), got {SHORT.repr(cells)}"
    for axis in (0, 1) if len(cells) else ():
        # By columns, as the minimum along axis 0 takes twenty times as long.
        first = round((origin[1 - axis] - start[1 - axis]) / belief.grid.resolution)
        least, most = first + int(cells[:, axis].min()), first + int(cells[:, axis].max())
        if least < 0 or most >= data.shape[axis]:
            return f"new_cells lie in {('rows', 'columns')[axis]} {least} to {most}; {size}"
    return ""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from lidarnaut.envs.files import SHORT
from lidarnaut.envs.geometry import ORIGIN, UNKNOWN, OccupancyGrid, Pose2D, Window
from lidarnaut.envs.simulation import Reading, Twist

NO_CELLS = np.empty((0, 2), dtype=np.int32)


class Correction(NamedTuple):
    """Displacement of map points by a loop closure, given as past robot poses before and after the correction."""

    before: np.ndarray
    """Past robot poses in the old map: shape (n, 3), float64 [m, m, rad]."""
    after: np.ndarray
    """Past robot poses in the corrected map: shape (n, 3), float64 [m, m, rad]."""

    def apply(self, points: np.ndarray) -> np.ndarray:
        """Return points of the old map moved to the corrected map: shape (k, 2), float64 [m].

        Each point moves like the nearest past robot pose.
        """
        points = np.asarray(points, dtype=np.float64).reshape(-1, 2)
        if len(self.before) == 0 or len(points) == 0:
            return points.copy()
        _, nearest = cKDTree(self.before[:, :2]).query(points)
        before, after = self.before[nearest], self.after[nearest]
        turn = after[:, 2] - before[:, 2]
        c, s, (x, y) = np.cos(turn), np.sin(turn), (points - before[:, :2]).T
        return after[:, :2] + np.column_stack([c * x - s * y, s * x + c * y])


class MapUpdate(NamedTuple):
    """Changes of the occupancy grid by the last scan."""

    new_cells: np.ndarray
    """Map cells that became known, or all known cells of a recomputed map, as (row, column): shape (k, 2), int32."""
    window: Window | None
    """Rectangle of map cells that may have changed; None if the scan was not added to the map."""
    redrawn: bool = False
    """True if the whole map was recomputed, after a loop closure or a change of the best particle."""
    origin: tuple[float, float] = (0.0, 0.0)
    """Position (x, y) of the corner of cell (0, 0) at the update, map frame [m]."""
    correction: Correction | None = None
    """Displacement of map points if the whole map was recomputed; None if unknown."""
    changed_cells: np.ndarray | None = None
    """Known map cells that became occupied or free, also repeatedly, as (row, column): shape (k, 2), int32; None if all
    known cells of `window` may have changed."""


NO_UPDATE = MapUpdate(NO_CELLS, None)


@dataclass(slots=True)
class Belief:
    """Output of a SLAM or localizer, in the map frame. Every scan updates the same object in place."""

    pose: Pose2D
    """Estimated pose of the robot's base."""
    grid: OccupancyGrid
    """Estimated occupancy grid. Its array is updated in place, and replaced when the map grows."""
    update: MapUpdate = NO_UPDATE
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    """Covariance of x, y and heading: shape (3, 3), float64 [m, m, rad]; zeros if not estimated."""
    grows: bool = False
    """True if scans extend the map (SLAM); False on a known map. `Robot.reset` sets it."""
    is_lost: bool = False
    """True if the pose estimate is unreliable."""
    rivals: np.ndarray = field(default_factory=lambda: np.empty((0, 4)))
    """Alternative poses that explain the scans equally well, as x, y, heading [m, m, rad] and weight relative to
    `pose`: shape (k, 4), float64."""
    twist: Twist | None = None
    """Estimated forward speed [m/s] and yaw rate [rad/s]; None if unknown."""
    people: np.ndarray = field(default_factory=lambda: np.empty((0, 5)))
    """Tracked people as x, y [m], velocity (x, y) [m/s] and radius [m]: shape (n, 5), float64, base frame."""
    on_people: np.ndarray | None = None
    """Mask of the last scan's beams that end at tracked or possible people, and are kept out of the map: shape
    (num_beams,), bool; None without tracking."""
    path: np.ndarray | None = None
    """Corrected trajectory if the map was redrawn, otherwise None: shape (n, 3), float64 [m, m, rad], one pose per
    processed scan."""

    @property
    def hypotheses(self) -> np.ndarray:
        """Estimated and alternative poses as x, y, heading [m, m, rad], weight (sum 1): shape (1 + k, 4), float64."""
        rows = np.vstack([(*self.pose, 1.0), self.rivals])
        rows[:, 3] /= rows[:, 3].sum()
        return rows


STEPS = ("update", "is_key_pose", "predict")
"""Methods of estimators that a robot does not call between key scans."""


class Estimator:
    """Base of SLAM and localization, which estimate pose and map from sensor readings and odometry.

    Subclasses define `update`. `reset` may have an argument `covariance` of the initial pose, shape (3, 3), float64 [m,
    m, rad].
    """

    belief: Belief
    """Current estimate, set by `reset` and changed in place by `update`."""
    rng: np.random.Generator
    """Random generator of the episode."""
    uses_first_scan: bool = True
    """Whether the scan at the reset is processed."""
    follows_odometry: bool = False
    """Whether odometry moves the pose between key scans, and only key scans are processed. A subclass that overrides
    `update` processes every scan, unless it declares otherwise."""
    shares_maps: bool = False
    """Whether the robots of a team can share one `map`."""
    map: Any = None
    """Map that `reset` of another estimator accepts; None if `shares_maps` is False."""
    particles: np.ndarray | None = None
    """Sampled poses for pictures, shape (n, 3), map frame [m, m, rad]; None for none."""
    observers: Sequence[Any] | None = None
    """Observers of the poses tested in scan matching; None if not supported."""
    anchor: Any = None
    """For replays: row of `belief.path`, and current pose relative to that row; None for paths with all scans."""
    loop_closures: int | None = None
    """Number of loop closures since the reset; None if loops are not closed."""
    pose_graph: Any = None
    """Graph with `nodes`, shape (n, 3), and `edges`, see `lidarnaut.envs.logs.runs.save_g2o`; None for none."""

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        bases = [base for base in cls.__bases__ if issubclass(base, Estimator)]
        overrides = any(getattr(cls, name, None) is not getattr(base, name, None) for base in bases for name in STEPS)
        if overrides and "follows_odometry" not in vars(cls):
            cls.follows_odometry = False

    def reset(self, rng: np.random.Generator, pose: Any = ORIGIN, map: Any = None) -> Belief:
        """Start a new episode and return the initial estimate; by default, an unknown map of one cell.

        `pose`: initial pose, map frame, or None if unknown on a known map; `map`: known or shared map, or None.

        Raises:
            ValueError: the estimator does not support these arguments.
        """
        if pose is None:
            raise ValueError(f"{type(self).__name__} needs a start pose")
        blank = OccupancyGrid(np.full((1, 1), UNKNOWN, dtype=np.int8), 0.05, (0.0, 0.0))
        self.rng, self.belief = rng, Belief(pose, blank if map is None else map)
        return self.belief

    def update(self, reading: Reading, motion: Pose2D) -> Belief:
        """Process a sensor reading; `motion` is the base pose relative to the last reading, by odometry."""
        raise NotImplementedError(f"{type(self).__name__} must define update(reading, motion)")

    def finish(self) -> None:
        """Complete corrections after the last scan of a replay, in `belief.path`."""


class DeadReckoning(Estimator):
    """Pose estimation by odometry alone; scans are ignored."""

    uses_first_scan = False
    follows_odometry = True

    def reset(
        self, rng: np.random.Generator, pose: Pose2D | None = ORIGIN, map: Any = None, covariance: Any = None
    ) -> Belief:
        if pose is None:
            raise ValueError("dead reckoning needs a start pose; use localizer='amcl'")
        return super().reset(rng, pose, map)

    def update(self, reading: Reading, motion: Pose2D) -> Belief:
        self.belief.pose = self.belief.pose.compose(motion)
        return self.belief


def check_belief(belief: Any, name: str, grid: OccupancyGrid | None = None, before: Any = (None, None)) -> None:
    """Check the pose estimate and map returned by the estimator called `name`.

    `grid`: expected grid object, None for any; `before`: data and shape of the grid before the update.

    Raises:
        ValueError: a value has the wrong type or shape, is not finite or lies outside the grid.
    """
    if fault := _fault_of(belief, grid, *before):
        raise ValueError(f"estimator {name}: {fault}")


def _fault_of(belief: Any, grid: Any, old_data: Any, old_shape: Any) -> str:
    if not isinstance(belief, Belief):
        return f"it must return a Belief, got {belief!r}"
    data, start, path = belief.grid.data, belief.grid.origin, () if belief.path is None else belief.path
    cells, window, _, origin, _, changed_cells = belief.update
    if (grid is not None and belief.grid is not grid) or (data is old_data and data.shape != old_shape):
        return "grid must stay the same OccupancyGrid during an episode; replace its data to change the shape"
    if data.ndim != 2 or data.dtype != np.int8:
        return f"grid.data must be a 2D int8 array, got {data.ndim}D {data.dtype}"
    if not (np.isfinite([*belief.pose, *start, *origin]).all() and np.isfinite(path).all()):
        return f"pose, origins and path must be finite, got {belief.pose}, {start}, {origin} and {path}"
    size = "the grid has {} rows and {} columns".format(*data.shape)
    row, col, rows, cols = sides = np.asarray((0, 0, 1, 1) if window is None else window)
    is_inside = 0 <= row < row + rows <= data.shape[0] and 0 <= col < col + cols <= data.shape[1]
    if sides.dtype.kind not in "iu" or not is_inside:
        return f"update.window must lie inside the grid, got {window}; {size}"
    for name, each in (("new_cells", cells), ("changed_cells", NO_CELLS if changed_cells is None else changed_cells)):
        if not (isinstance(each, np.ndarray) and each.dtype.kind in "iu" and each.ndim == 2 and each.shape[1] == 2):
            return f"{name} must be an array of integers, shape (k, 2), got {SHORT.repr(each)}"
        for axis in (0, 1) if len(each) else ():
            # The minimum along axis 0 is twenty times as slow.
            first = round((origin[1 - axis] - start[1 - axis]) / belief.grid.resolution)
            least, most = first + int(each[:, axis].min()), first + int(each[:, axis].max())
            if least < 0 or most >= data.shape[axis]:
                return f"{name} lie in {('rows', 'columns')[axis]} {least} to {most}; {size}"
    return ""

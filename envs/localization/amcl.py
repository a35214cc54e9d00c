"""AMCL: adaptive Monte Carlo localization, as in Nav2."""

import logging
import math
import weakref
from collections import deque
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from lidarnaut.envs.estimation import Belief, Estimator
from lidarnaut.envs.geometry import ORIGIN, OccupancyGrid, Pose2D
from lidarnaut.envs.robots import LidarParams
from lidarnaut.envs.simulation import Reading
from lidarnaut.envs.slam.scans import check_scan

from .amcl_params import AmclParams
from .beam_model import BeamModel
from .clusters import BinRaster, find_bins, heaviest_cluster, mean_and_covariance, resample
from .likelihood_field import LikelihoodField
from .motion_model import move_particles
from .rivals import MIN_LEAD, NO_RIVALS, NUM_SEARCHES, TOLERANCE, Rivals, share_crossed

_MIN_HITS = 5
_WIDE_FACTOR = 4.0
BIN_SIZE, BIN_ANGLE = 0.5, math.radians(10.0)
"""Side length [m] and heading width [rad] of histogram bins in KLD-sampling and clustering; headings are rounded to
divide a full turn evenly."""
INITIAL_STD = (0.5, 0.5, math.radians(15.0))
"""Standard deviations of the initial pose [m, m, rad], as in Nav2."""
MAX_SPREAD = 0.5
"""Position spread (RMS) of the heaviest particle cluster above which the robot is lost [m]."""
MIN_MERIT = 0.2
"""Minimum fit of a tracked pose in a changed place, minus the share of beams through mapped obstacles."""
FIT_DROP, FIT_RISE = 0.1, 0.1 / 30
"""Fit that starts the next search for a better pose: distance below the fit at the last search, and rise per update."""
_RIVAL_COVARIANCE = np.diag(np.square([0.05, 0.05, 0.02]))


def _mean(shares: list[float]) -> float:
    # `sum` rounds differently since Python 3.12.
    return float(np.cumsum(shares)[-1]) / len(shares) if shares else math.nan


def check_covariance(covariance: Any) -> np.ndarray:
    """Return the covariance of a pose as an array, shape (3, 3), float64 [m, m, rad]; ValueError if it is none."""
    covariance = np.asarray(covariance, dtype=np.float64)
    if covariance.shape != (3, 3) or not np.isfinite(covariance).all():
        raise ValueError(f"covariance must be a finite 3 x 3 matrix, got {covariance}")
    if not np.allclose(covariance, covariance.T) or np.linalg.eigvalsh(covariance)[0] < -1e-9:
        raise ValueError(f"covariance must be symmetric and positive semidefinite, got {covariance.tolist()}")
    return covariance


class _MapTables:
    in_use: ClassVar[weakref.WeakValueDictionary[tuple, "_MapTables"]] = weakref.WeakValueDictionary()

    def __init__(self, key: tuple, params: AmclParams, lidar: LidarParams, occupancy: OccupancyGrid) -> None:
        free = occupancy.free
        if not free.any():
            raise ValueError("the map has no free cell")
        self.key, self.map = key, replace(occupancy, data=occupancy.data.copy(), origin=(0.0, 0.0))
        self.is_free, self.free_cells = free, np.argwhere(free)
        self.area = len(self.free_cells) * occupancy.resolution**2
        self.field = LikelihoodField(params, lidar, self.map)
        self.sensor_model = BeamModel(params, lidar, self.map) if params.sensor == "beam" else self.field
        self.raster = BinRaster.over(self.map.bounds, BIN_SIZE, BIN_ANGLE)
        self.in_use[key] = self


class Amcl(Estimator):
    """Adaptive Monte Carlo localization with KLD-sampling.

    Between filter updates, the estimated pose follows odometry. Fox, "Adapting the sample size in particle filters
    through KLD-sampling" (2003); Thrun, Burgard, Fox, "Probabilistic Robotics" (2005), table 8.3.
    """

    uses_first_scan = False
    belief: Belief
    """Map, and estimated pose: mean and covariance of the heaviest particle cluster. `is_lost` is True before
    convergence, while other poses may explain the scans, or if the scans do not fit the map."""

    def __init__(self, lidar: LidarParams, params: AmclParams) -> None:
        self.params = params
        self._lidar = lidar
        self._tables: _MapTables
        self._least_fit: float = params.lost_fit
        self._bins = np.empty(max(params.max_particles, params.global_particles or 0), dtype=np.int32)
        self._spare = np.empty((3, params.max_particles), dtype=np.float32)
        self.cluster_weight: float
        """Weight of the heaviest particle cluster, from 0 to 1."""
        self.is_corrected = False
        """Whether the last scan updated the particles."""

    @property
    def fit(self) -> float:
        """Share of beam end points of recent scans near mapped obstacles; NaN before convergence."""
        return _mean([fit for fit, _ in self._judged])

    @property
    def _has_converged(self) -> bool:
        variance = self.belief.covariance[0, 0] + self.belief.covariance[1, 1]
        return bool(self.cluster_weight >= 0.5 and variance <= MAX_SPREAD**2)

    @property
    def particles(self) -> np.ndarray:  # type: ignore[override]
        """Copy of the particles x, y, heading: shape (n, 3), float64, map frame [m, m, rad]."""
        return self._particles.T + self._origin

    @property
    def num_particles(self) -> int:
        return len(self._weights)

    def reset(
        self,
        rng: np.random.Generator,
        pose: Pose2D | None = ORIGIN,
        map: OccupancyGrid | None = None,
        covariance: np.ndarray | None = None,
    ) -> Belief:
        """Start on a known map at a `pose` (map frame), or by global localization (None).

        `covariance`: covariance of `pose`, shape (3, 3) [m, m, rad]; None for `INITIAL_STD`.

        Raises:
            ValueError: no map, no free cell, `pose` outside of the map, or invalid covariance.
        """
        if map is None:
            raise ValueError("localization needs a map")
        self._prepare(map)
        self.rng = rng
        if pose is not None:
            self._check_pose(pose, map)
        self._start(pose, covariance)
        self._moved = ORIGIN
        self.belief = Belief(ORIGIN, map)
        self._summarise()
        return self.belief

    def update(self, reading: Reading, motion: Pose2D) -> Belief:
        """Update the estimate by a scan; `motion`: base pose by odometry relative to the last scan.

        Raises:
            ValueError: wrong number of beams, or motion not finite.
            RuntimeError: `reset` was not called.
        """
        if not hasattr(self, "_tables"):
            raise RuntimeError("AMCL has no map yet; call reset first")
        ranges = check_scan(reading.ranges, motion, self._lidar)
        self._moved = moved = self._moved.compose(motion)
        params = self.params
        has_moved = math.hypot(moved.x, moved.y) >= params.update_min_d or abs(moved.theta) >= params.update_min_a
        self.is_corrected = has_moved or self._num_updates == 0
        if self.is_corrected:
            move_particles(self._particles, moved, params, self.rng)
            self._moved = ORIGIN
            if self._rivals is not None:
                self._rivals.add(ranges, moved)
            self._scans.append((ranges.copy(), moved))
            self._correct(ranges)
            if self._rivals is not None:
                self._compare(self._rivals, ranges)
            self._least_fit = min(max(self._least_fit + FIT_RISE, self.fit - FIT_DROP), params.lost_fit)
            if len(self._judged) == params.lost_updates and self.fit < self._least_fit:
                self._recover(ranges)
        else:
            self.belief.pose = self._in_map(self._local_pose).compose(moved)
        self.belief.rivals = NO_RIVALS if self._rivals is None else self._rivals.table(self._origin, self._moved)
        return self.belief

    def _prepare(self, occupancy: OccupancyGrid) -> None:
        data, params, lidar = occupancy.data, self.params, self._lidar
        self._origin = np.array([*occupancy.origin, 0.0])
        key = (params, lidar, occupancy.resolution, data.shape, data.tobytes())
        if not hasattr(self, "_tables") or key != self._tables.key:
            self._tables = _MapTables.in_use.get(key) or _MapTables(key, params, lidar, occupancy)
            self._seen = np.zeros(math.prod(self._tables.raster.shape), dtype=np.bool_)

    def _check_pose(self, pose: Pose2D, occupancy: OccupancyGrid) -> None:
        if not all(map(math.isfinite, pose)):
            raise ValueError(f"the initial pose must be finite, got {tuple(pose)}")
        cell = occupancy.cells(np.array(pose[:2]))
        if not occupancy.contains(cell):
            raise ValueError(f"the initial pose {tuple(pose)} lies outside the map, which covers {occupancy.bounds}")
        if not self._tables.is_free[tuple(cell)]:  # moved furniture or map errors
            text = "the initial pose (%.2f, %.2f) lies on a cell of the map that is not free"
            logging.getLogger(__name__).warning(text, pose.x, pose.y)

    def _draw_anywhere(self, count: int) -> np.ndarray:
        free_cells = self._tables.free_cells
        cells = free_cells[self.rng.integers(len(free_cells), size=count)]
        positions = self._tables.map.centers(cells + self.rng.uniform(-0.5, 0.5, (count, 2)))
        return np.stack([*positions.T, self.rng.uniform(-math.pi, math.pi, count)]).astype(np.float32)

    def _draw_around(self, pose: Pose2D, covariance: np.ndarray | None) -> np.ndarray:
        params = self.params
        if covariance is None:
            covariance = np.diag(np.square(INITIAL_STD))
        values, vectors = np.linalg.eigh(check_covariance(covariance))
        noise = vectors * np.sqrt(np.maximum(values, 0.0)) @ self.rng.standard_normal((3, params.max_particles))
        # Rounding errors of large coordinates must not change the samples.
        x, y, theta = noise + np.round(pose - self._origin, 6)[:, None]
        return np.stack([x, y, (theta + math.pi) % (2.0 * math.pi) - math.pi]).astype(np.float32)

    def _start(self, pose: Pose2D | None, covariance: np.ndarray | None = None) -> None:
        if pose is None:
            self._particles = self._draw_anywhere(self.params.global_particles or self.params.max_particles)
        else:
            self._particles = self._draw_around(pose, covariance)
        # None once the estimate is confirmed.
        self._rivals = Rivals(self._tables.field, self.params.lost_updates) if pose is None else None
        count = self._particles.shape[1]
        self._weights = np.full(count, 1.0 / count)
        self._num_updates = 0
        self._slow = self._fast = 0.0
        self._least_fit = self.params.lost_fit
        # Fit, and fit minus the share of beams through mapped obstacles.
        self._judged: deque[tuple[float, float]] = deque(maxlen=self.params.lost_updates)
        self._scans: deque[tuple[np.ndarray, Pose2D]] = deque(maxlen=self.params.lost_updates)

    def _correct(self, ranges: np.ndarray) -> None:
        weigh = self._tables.sensor_model(ranges)
        if weigh is not None:
            likelihood = weigh(self._particles, self._weights)
            self._weights /= self._weights.sum()
            if self._slow == 0.0:
                self._slow = self._fast = likelihood
            # Long-term and short-term average likelihood (Thrun et al. 2005, table 8.3).
            self._slow += self.params.alpha_slow * (likelihood - self._slow)
            self._fast += self.params.alpha_fast * (likelihood - self._fast)
        self._summarise(ranges)
        self._num_updates += 1
        if weigh is not None and self._num_updates % self.params.resample_interval == 0:
            self._resample()

    def _resample(self) -> None:
        params, rng = self.params, self.rng
        share, anywhere = 0.0, np.empty((3, 0), dtype=np.float32)
        if params.alpha_slow > 0.0 and self._fast < self._slow:
            share = 1.0 - self._fast / self._slow
            anywhere = self._draw_anywhere(math.ceil(params.max_particles * share) + 1)
            self._slow = self._fast = 0.0
        particles, bins = self._particles, self._bins[: len(self._weights)]
        limits = params.min_particles, params.kld_err, params.kld_z
        start = rng.random()
        count = resample(particles, self._weights, bins, start, limits, anywhere, share, self._seen, self._spare)
        self._particles = np.ascontiguousarray(self._spare[:, :count])
        self._weights = np.full(count, 1.0 / count)

    def _recover(self, ranges: np.ndarray) -> None:
        if self._rivals is None and self.params.relocalize and not self._has_left():
            self._look_elsewhere(ranges)
        elif self.params.relocalize or self._has_left():
            self._start(None)
            self._correct(ranges)
        elif self._rivals is None and self.params.alpha_slow > 0.0:
            self._rivals = Rivals(self._tables.field, self.params.lost_updates)

    def _look_elsewhere(self, ranges: np.ndarray) -> None:
        """Give up the tracked pose if another one explains the scans since the fit fell clearly better."""
        rivals = Rivals(self._tables.field, self.params.lost_updates, MIN_LEAD)
        first = next(k for k, (fit, _) in enumerate(self._judged) if fit < self.params.lost_fit)
        for scan, moved in list(self._scans)[first - len(self._judged) :]:
            rivals.add(scan, moved)
        rivals.update(self._local_pose, self.rng, self._tables.area, self._draw_anywhere)
        if len(rivals.poses) > 1:
            rivals.least_lead = -TOLERANCE
            self._start_at_rival(rivals, ranges)
        else:
            self._least_fit = self.fit - FIT_DROP

    def _start_at_rival(self, rivals: Rivals, ranges: np.ndarray) -> None:
        self._start(Pose2D(*(rivals.poses[1] + self._origin)), _RIVAL_COVARIANCE)
        self._rivals = rivals
        self._correct(ranges)

    def _has_left(self) -> bool:
        tables = self._tables
        cells = tables.map.cells(self._particles[:2].T)
        return not tables.is_free[tuple(cells[tables.map.contains(cells)].T)].any()

    def _compare(self, rivals: Rivals, ranges: np.ndarray) -> None:
        tables, is_full, fits = self._tables, len(self._judged) == self._judged.maxlen, self.fit >= self.params.lost_fit
        if len(rivals.poses) <= 1 and not (is_full and (fits or self.params.relocalize)):
            return
        rivals.update(self._local_pose, self.rng, tables.area, self._draw_anywhere)
        if len(rivals.poses) > 1 and rivals.leads[1] > TOLERANCE:
            self._start_at_rival(rivals, ranges)
        elif rivals.num_empty >= NUM_SEARCHES and is_full and fits:
            self._rivals, self.belief.is_lost = None, not self._has_converged

    def _summarise(self, ranges: np.ndarray | None = None) -> None:
        tables, particles, weights = self._tables, self._particles, self._weights
        bins = self._bins[: len(weights)]
        extent = find_bins(particles, tables.raster, bins)
        # At most two bins per axis are always connected.
        weight, members = (1.0, weights) if extent <= 2 else heaviest_cluster(bins, weights, tables.raster)
        covariance = np.empty((3, 3))
        local = Pose2D(*mean_and_covariance(particles, members, weight, covariance))
        self.cluster_weight, self._local_pose, belief = weight, local, self.belief
        belief.pose, belief.covariance = self._in_map(local), covariance
        has_converged = self._has_converged
        if self._rivals is None and covariance[0, 0] + covariance[1, 1] > _WIDE_FACTOR**2 * MAX_SPREAD**2:
            self._rivals = Rivals(tables.field, self.params.lost_updates)
        share, hits = (0.0, 0) if ranges is None or not has_converged else tables.field.fit(ranges, local)
        if ranges is not None and hits >= _MIN_HITS:
            crossed = share_crossed(tables.field, ranges, local) if share < self.params.lost_fit else 0.0
            self._judged.append((share, share - crossed))
        elif ranges is not None and self._has_left():
            self._judged.append((0.0, 0.0))
        elif not has_converged:
            self._judged.clear()
        belief.is_lost = not (has_converged and self._rivals is None) or (
            self.fit < self.params.lost_fit
            and not (self.params.relocalize and _mean([merit for _, merit in self._judged]) >= MIN_MERIT)
        )

    def _in_map(self, local: Pose2D) -> Pose2D:
        x, y, _ = self._origin.tolist()
        return Pose2D(local.x + x, local.y + y, local.theta)

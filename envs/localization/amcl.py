"""AMCL: adaptive Monte Carlo localization, as in Nav2."""

import math
import weakref
from collections import deque
from dataclasses import replace
from typing import ClassVar

import numpy as np

from envs.estimation import ORIGIN
from envs.geometry import OccupancyGrid, Pose2D
from envs.robots import LidarParams
from envs.slam.scans import check_scan
from envs.worlds.map_files import FREE_THRESH

from .beam_model import BeamModel
from .clusters import BinRaster, find_bins, heaviest_cluster, mean_and_covariance
from .likelihood_field import LikelihoodField
from .localizer import PoseEstimate
from .motion_model import differential_drive
from .params import AmclParams
from .resampling import Injection, KldParams, resample

_NO_INJECTION = Injection(np.empty((3, 1), dtype=np.float32), 0.0)
_MIN_HITS = 5
"""Least number of hits for which the fit of a scan to the map is computed."""


class _MapTables:
    """What is computed from a map alone, is large and never changes: equal localizers on equal maps share it."""

    in_use: ClassVar[weakref.WeakValueDictionary[tuple, "_MapTables"]] = weakref.WeakValueDictionary()

    def __init__(self, key: tuple, params: AmclParams, lidar: LidarParams, occupancy: OccupancyGrid) -> None:
        free = (occupancy.data >= 0) & (occupancy.data < 100 * FREE_THRESH)
        if not free.any():
            raise ValueError("the map has no free cell, so the robot can be nowhere")
        self.key, self.map = key, replace(occupancy, data=occupancy.data.copy())
        self.free_cells = np.argwhere(free)
        self.field = LikelihoodField(params, lidar, occupancy)
        self.sensor_model = BeamModel(params, lidar, occupancy) if params.sensor == "beam" else self.field
        self.raster = BinRaster.over(occupancy.bounds, params.bin_size, params.bin_angle)
        self.in_use[key] = self


class Amcl:
    """An augmented particle filter whose size follows the spread of its particles.

    Each scan that is used goes through four steps: propagate, reweight, normalize, resample. Fox, "Adapting the sample
    size in particle filters through KLD-sampling" (2003); Thrun, Burgard, Fox, "Probabilistic Robotics" (2005),
    table 8.3.
    """

    def __init__(self, lidar: LidarParams, params: AmclParams) -> None:
        """Build a localizer for one lidar."""
        self.params = params
        self._lidar = lidar
        self._kld = KldParams(params.min_particles, params.kld_err, params.kld_z)
        self._tables: _MapTables
        self._bins = np.empty(params.most_particles, dtype=np.int32)
        self._spare = np.empty((3, params.max_particles), dtype=np.float32)

    @property
    def particles(self) -> np.ndarray:
        """Shape (n, 3), float64: x, y, heading of the particles in the map frame [m, rad]; a copy."""
        return self._particles.T.astype(np.float64)

    @property
    def num_particles(self) -> int:
        """Number of particles."""
        return len(self._weights)

    @property
    def weights(self) -> np.ndarray:
        """Shape (n,), float64: weights of the particles, with the sum 1; a copy."""
        return self._weights.copy()

    def reset(
        self,
        occupancy: OccupancyGrid,
        pose: Pose2D | None,
        rng: np.random.Generator,
        *,
        covariance: np.ndarray | None = None,
    ) -> PoseEstimate:
        """Start on a map, see `Localizer`; by default `covariance` follows from the params' `initial_std`."""
        self._prepare(occupancy)
        self.rng = rng
        if pose is not None:
            self._check_pose(pose, occupancy)
        self._start(pose, covariance)
        self._moved = ORIGIN
        self.estimate = self._corrected = self._summarise()
        return self.estimate

    def update(self, ranges: np.ndarray, motion: Pose2D) -> PoseEstimate:
        """Update by one scan, see `Localizer`; until the robot has moved far enough, by odometry alone."""
        if not hasattr(self, "_tables"):
            raise RuntimeError("AMCL has no map yet; call reset first")
        ranges = check_scan(ranges, motion, self._lidar)
        self._moved = moved = self._moved.compose(motion)
        params = self.params
        has_moved = math.hypot(moved.x, moved.y) >= params.update_min_d or abs(moved.theta) >= params.update_min_a
        if has_moved or self._num_updates == 0:
            differential_drive(params, moved)(self._particles, self.rng)
            self._moved = ORIGIN
            self._correct(ranges)
            if params.relocalize and len(self._fits) == params.lost_updates and self._corrected.fit < params.lost_fit:
                self._start(None)  # the map has not explained the last scans
                self._correct(ranges)
            self.estimate = self._corrected
        else:
            at_scan = self._corrected
            self.estimate = replace(
                at_scan, pose=at_scan.pose.compose(moved), mean=at_scan.mean.compose(moved), is_corrected=False
            )
        return self.estimate

    def _prepare(self, occupancy: OccupancyGrid) -> None:
        """Compute what depends on the map alone, unless it is the same as before."""
        data, params, lidar = occupancy.data, self.params, self._lidar
        key = (params, lidar, occupancy.resolution, *occupancy.origin, data.shape, data.tobytes())
        if not hasattr(self, "_tables") or key != self._tables.key:
            self._tables = _MapTables.in_use.get(key) or _MapTables(key, params, lidar, occupancy)
            self._seen = np.zeros(math.prod(self._tables.raster.shape), dtype=np.bool_)

    def _check_pose(self, pose: Pose2D, occupancy: OccupancyGrid) -> None:
        if not all(map(math.isfinite, pose)):
            raise ValueError(f"the initial pose must be finite, got {tuple(pose)}")
        cell = occupancy.cells(np.array(pose[:2]))
        if not occupancy.contains(cell):
            raise ValueError(f"the initial pose {tuple(pose)} lies outside the map, which covers {occupancy.bounds}")
        value = occupancy.data[tuple(cell)]
        if not 0 <= value < 100 * FREE_THRESH:
            what = "unknown" if value < 0 else f"{value} % occupied"
            raise ValueError(f"the initial pose {tuple(pose)} lies on a cell of the map that is {what}, not free")

    def _draw_anywhere(self, count: int) -> np.ndarray:
        """Draw particles uniformly over the map's free space and all headings: shape (3, count), float32."""
        free_cells = self._tables.free_cells
        cells = free_cells[self.rng.integers(len(free_cells), size=count)]
        positions = self._tables.map.centers(cells + self.rng.uniform(-0.5, 0.5, (count, 2)))
        return np.stack([*positions.T, self.rng.uniform(-math.pi, math.pi, count)]).astype(np.float32)

    def _draw_around(self, pose: Pose2D, covariance: np.ndarray | None) -> np.ndarray:
        """Draw particles around a pose: shape (3, max_particles), float32."""
        params = self.params
        if covariance is None:
            covariance = np.diag(np.square([params.initial_std, params.initial_std, params.initial_std_theta]))
        covariance = np.asarray(covariance, dtype=np.float64)
        if covariance.shape != (3, 3) or not np.isfinite(covariance).all():
            raise ValueError(f"covariance must be a finite 3 x 3 matrix, got {covariance}")
        values, vectors = np.linalg.eigh(covariance)
        if not np.allclose(covariance, covariance.T) or values[0] < -1e-9:
            raise ValueError(f"covariance must be symmetric and positive semidefinite, got {covariance.tolist()}")
        noise = vectors * np.sqrt(np.maximum(values, 0.0)) @ self.rng.standard_normal((3, params.max_particles))
        x, y, theta = noise + np.array(pose)[:, None]
        return np.stack([x, y, (theta + math.pi) % (2.0 * math.pi) - math.pi]).astype(np.float32)

    def _start(self, around: Pose2D | None, covariance: np.ndarray | None = None) -> None:
        """Draw equally weighted particles around a pose, or for None anywhere, and forget all scans."""
        if around is None:
            self._particles = self._draw_anywhere(self.params.global_particles or self.params.max_particles)
        else:
            self._particles = self._draw_around(around, covariance)
        self._is_confirmed = around is not None
        count = self._particles.shape[1]
        self._weights = np.full(count, 1.0 / count)
        self._num_updates = 0
        self._slow = self._fast = 0.0
        self._fits: deque[float] = deque(maxlen=self.params.lost_updates)

    def _correct(self, ranges: np.ndarray) -> None:
        """Reweight by a scan, normalize, summarise, and resample."""
        weigh = self._tables.sensor_model(ranges)
        if weigh is not None:
            likelihood = weigh(self._particles, self._weights)
            self._weights /= self._weights.sum()
            if self._slow == 0.0:
                self._slow = self._fast = likelihood
            # Long-term and short-term average of the likelihood (Thrun et al. 2005, table 8.3).
            self._slow += self.params.alpha_slow * (likelihood - self._slow)
            self._fast += self.params.alpha_fast * (likelihood - self._fast)
        self._corrected = self._summarise(ranges)
        self._num_updates += 1
        if weigh is not None and self._num_updates % self.params.resample_interval == 0:
            self._resample()

    def _resample(self) -> None:
        """Draw the next particles by weight; some at random where the likelihood has fallen."""
        params, rng = self.params, self.rng
        injection = _NO_INJECTION
        if params.alpha_slow > 0.0 and self._fast < self._slow:
            share = 1.0 - self._fast / self._slow
            injection = Injection(self._draw_anywhere(math.ceil(params.max_particles * share) + 1), share)
            self._slow = self._fast = 0.0
        particles, bins = self._particles, self._bins[: self._particles.shape[1]]
        count = resample(particles, self._weights, bins, injection, rng.random(), self._kld, self._seen, self._spare)
        self._particles = np.ascontiguousarray(self._spare[:, :count])
        self._weights = np.full(count, 1.0 / count)

    def _summarise(self, ranges: np.ndarray | None = None) -> PoseEstimate:
        """Compute the estimate from the weighted particles, and judge it by a scan if there is one."""
        tables, particles, weights = self._tables, self._particles, self._weights
        bins = self._bins[: len(weights)]
        extent = find_bins(particles, tables.raster, bins)
        # In a cloud of at most two bins along each axis, all bins touch.
        weight, members = (1.0, weights) if extent <= 2 else heaviest_cluster(bins, weights, tables.raster)
        covariance, mean_covariance = np.empty((3, 3)), np.empty((3, 3))
        pose = Pose2D(*mean_and_covariance(particles, members, weight, covariance))
        if weight == 1.0:
            mean, mean_covariance = pose, covariance.copy()
        else:
            mean = Pose2D(*mean_and_covariance(particles, weights, 1.0, mean_covariance))
        has_converged = weight >= 0.5 and covariance[0, 0] + covariance[1, 1] <= self.params.lost_spread**2
        if not has_converged:
            self._fits.clear()
        elif ranges is not None:
            share, hits = tables.field.fit(ranges, pose)
            if hits >= _MIN_HITS:
                self._fits.append(share)
        fit = sum(self._fits) / len(self._fits) if self._fits else math.nan
        self._is_confirmed |= len(self._fits) == self._fits.maxlen and fit >= self.params.lost_fit
        is_lost = not (has_converged and self._is_confirmed) or fit < self.params.lost_fit
        return PoseEstimate(pose, covariance, weight, mean, mean_covariance, fit, is_lost, ranges is not None)

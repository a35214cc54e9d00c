"""AMCL along a recorded drive."""

import time
from dataclasses import dataclass

import numpy as np

from benchmarks.recorded_drives import Drive
from envs.geometry import OccupancyGrid, Pose2D
from envs.localization import Amcl


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Estimates at the n scans of a drive, all of shape (n, ...)."""

    poses: np.ndarray
    """Shape (n, 3), float64: estimated poses [m, rad]."""
    is_lost: np.ndarray
    """Whether the filter called itself lost."""
    fit: np.ndarray
    """Share of hits that the map explains."""
    is_corrected: np.ndarray
    """Whether the scan was used."""
    num_particles: np.ndarray
    """Number of particles after the scan."""
    seconds: np.ndarray
    """Time of the update [s]."""


def localize(
    amcl: Amcl, grid: OccupancyGrid, drive: Drive, seed: int, start_std: tuple[float, float, float] | None
) -> Track:
    """Localize along a drive.

    Args:
        amcl: the filter; it is reset.
        grid: the map.
        drive: the recorded drive.
        seed: of the filter's noise.
        start_std: standard deviations of the initial pose, which is the true one [m, m, rad]; None for global
            localization.
    """
    start = None if start_std is None else Pose2D(*drive.truth[0].tolist())
    covariance = None if start_std is None else np.diag(np.square(start_std))
    amcl.reset(grid, start, np.random.default_rng(seed), covariance=covariance)
    rows = []
    for ranges, motion in zip(drive.ranges, drive.motions.tolist()):
        begin = time.perf_counter()
        estimate = amcl.update(ranges, Pose2D(*motion))
        seconds = time.perf_counter() - begin
        rows.append((estimate.pose, estimate.is_lost, estimate.fit, estimate.is_corrected, amcl.num_particles, seconds))
    return Track(*map(np.array, zip(*rows)))

"""The log of a drive: wheel odometry and laser scans of a robot."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from envs.geometry import Pose2D
from envs.robots import LidarParams, Mount


class ScanGeometry(NamedTuple):
    """Where the beams of a scan point."""

    angle_min: float
    """Direction of the first beam in the base frame [rad]."""
    increment: float
    """Angle between two beams [rad]."""
    max_range: float
    """Readings from this on count as no return [m]."""
    mount_x: float = 0.0
    """Position of the lidar along the x axis of the base [m]."""

    def lidar(self, num_beams: int) -> LidarParams:
        """Return the lidar of a robot whose scans have this geometry."""
        fov = self.increment * (num_beams - 1)
        yaw = self.angle_min + fov / 2  # LidarParams centres the field of view on the sensor's x axis
        return LidarParams(num_beams, self.max_range, fov=fov, mount=Mount(self.mount_x, yaw=yaw))


@dataclass(frozen=True, slots=True, eq=False)
class Log:
    """What a robot recorded on a drive."""

    times: np.ndarray
    """Shape (n,), float64: when odometry was read [s]; clocks may jump back a little."""
    odometry: np.ndarray
    """Shape (n, 3), float64: pose of the base by its wheels, x, y, heading [m, rad]."""
    scan_rows: np.ndarray
    """Shape (m,), int64: rows of `times` and `odometry` at which the scans were taken."""
    ranges: np.ndarray
    """Shape (m, num_beams), float32 [m]; +inf for no return."""
    lidar: LidarParams
    """Geometry of the scans."""

    def motions(self) -> Iterator[Pose2D]:
        """Yield for each scan the pose of the base by odometry, seen from the base at the scan before."""
        poses = [Pose2D(*row) for row in self.odometry[self.scan_rows].tolist()]
        yield Pose2D(0.0, 0.0, 0.0)
        for before, after in itertools.pairwise(poses):
            yield before.between(after)

    @classmethod
    def checked(
        cls,
        path: Path,
        times: np.ndarray,
        odometry: np.ndarray,
        scan_rows: np.ndarray,
        ranges: np.ndarray,
        geometry: ScanGeometry,
    ) -> "Log":
        """Return the log of a file.

        Args:
            path: the file, for messages.
            times: see `Log`.
            odometry: see `Log`.
            scan_rows: see `Log`.
            ranges: shape (m, num_beams) [m], as recorded.
            geometry: of the scans.

        Raises:
            ValueError: sizes or values do not fit together.
        """
        if not len(times) == len(odometry) or not len(scan_rows) == len(ranges):
            raise ValueError(f"{path}: numbers of times, poses and scans do not agree")
        if len(ranges) == 0:
            raise ValueError(f"{path}: holds no scans")
        if not (np.isfinite(times).all() and np.isfinite(odometry).all()):
            raise ValueError(f"{path}: times and odometry must be finite")
        if scan_rows.min() < 0 or scan_rows.max() >= len(times):
            raise ValueError(f"{path}: scans refer to rows of odometry that do not exist")
        ranges = np.where(ranges >= geometry.max_range, np.float32(np.inf), ranges.astype(np.float32))
        return cls(times, odometry, scan_rows.astype(np.int64), ranges, geometry.lidar(ranges.shape[1]))

"""Frames and transforms of ROS, looked up by the rules of tf2 (REP 105)."""

from array import array
from collections import Counter
from collections.abc import Iterable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

MIN_UPRIGHT = 0.9
"""Least vertical part of the z axis of a lidar that scans a plane of the map: a tilt of 26 degrees."""
SAME_TRANSFORM = 1e-6
"""A transform whose numbers change by less than this does not move [m, or parts of a quaternion]."""


class FrameTree:
    """Frames by the transforms between them.

    The last static transform of a frame holds at all times. Moving ones are interpolated between their stamps, and
    unknown beyond them. Transforms that are not finite, or no rotation, are ignored, and frames that a lookup does not
    need are not looked at.
    """

    def __init__(self) -> None:
        self._static: dict[str, tuple[str, list[float]]] = {}
        self._moving: dict[str, dict[str, array[float]]] = {}
        self.ignored: Counter[str] = Counter()
        """Number of transforms that lookups ignored, by frame."""

    def add(self, transforms: Iterable[Any], *, static: bool) -> None:
        """Add `geometry_msgs/TransformStamped` messages."""
        for one in transforms:
            child, parent = frame_name(one.child_frame_id), frame_name(one.header.frame_id)
            t, q = one.transform.translation, one.transform.rotation
            row = [seconds(one.header.stamp), t.x, t.y, t.z, q.x, q.y, q.z, q.w]
            if child == parent:
                continue
            if not static:
                self._moving.setdefault(child, {}).setdefault(parent, array("d")).extend(row)
            elif _is_transform(np.array(row)):
                self._static[child] = parent, row

    @property
    def frames(self) -> list[str]:
        """Names of all frames."""
        parents = [parent for parent, _ in self._static.values()] + [p for each in self._moving.values() for p in each]
        return sorted({*self._static, *self._moving, *parents})

    def parent(self, frame: str) -> str | None:
        """Return the parent of a frame, of several moving ones that with the most transforms; None for a root."""
        if frame in self._static:
            return self._static[frame][0]
        parents = self._moving.get(frame, {})
        return max(parents, key=lambda parent: len(parents[parent]), default=None)

    def above(self, frame: str) -> list[str]:
        """Return a frame and the frames above it, up to the root."""
        names = [frame]
        while (parent := self.parent(names[-1])) is not None and parent not in names:  # circles end
            names.append(parent)
        return names

    def stamps(self, frame: str) -> np.ndarray:
        """Return the times of the valid transforms from a frame to its parent, ascending, shape (n,) [s]."""
        return self._rows(frame)[:, 0]

    def find(self, base: str, frame: str, times: np.ndarray) -> np.ndarray | None:
        """Return the poses of a frame in the base's frame at times, shape (n,) [s]: shape (n, 4, 4).

        NaN where they are unknown; None if the frames are not connected.
        """
        up, down = self.above(base), self.above(frame)
        common = next((name for name in down if name in up), None)
        if common is None:
            return None
        chains = up[: up.index(common)], down[: down.index(common)]
        base_pose, pose = (self._climb(chain, times) for chain in chains)
        result = np.full_like(pose, np.nan)
        known = np.isfinite(base_pose).all(axis=(1, 2)) & np.isfinite(pose).all(axis=(1, 2))
        result[known] = np.linalg.inv(base_pose[known]) @ pose[known]
        return result

    def _climb(self, chain: list[str], times: np.ndarray) -> np.ndarray:
        """Return the pose of the first frame of a chain in the parent of the last one, shape (n, 4, 4)."""
        pose = np.tile(np.eye(4), (len(times), 1, 1))
        for frame in chain:
            pose = self._at(frame, times) @ pose
        return pose

    def _rows(self, frame: str) -> np.ndarray:
        """Return the valid transforms from a frame to its parent by time, shape (n, 8): stamp, position, quaternion."""
        if frame in self._static:
            return np.array([self._static[frame][1]])
        rows = np.array(self._moving[frame][self.parent(frame) or ""]).reshape(-1, 8)
        is_valid = _is_transform(rows)
        self.ignored[frame] = int((~is_valid).sum())
        _, first = np.unique(rows[is_valid, 0], return_index=True)
        return rows[is_valid][first]

    def _at(self, frame: str, times: np.ndarray) -> np.ndarray:
        """Return the transforms from a frame to its parent at times, shape (n, 4, 4)."""
        rows, result = self._rows(frame), np.tile(np.eye(4), (len(times), 1, 1))
        if not len(rows):
            return np.full_like(result, np.nan)
        rotations = Rotation.from_quat(rows[:, 4:])
        if (np.ptp(rows[:, 1:], axis=0) < SAME_TRANSFORM).all():
            result[:, :3, :3], result[:, :3, 3] = rotations[0].as_matrix(), rows[0, 1:4]
            return result
        inside = (times >= rows[0, 0]) & (times <= rows[-1, 0])
        result[inside, :3, :3] = Slerp(rows[:, 0], rotations)(times[inside]).as_matrix()
        for axis in range(3):
            result[:, axis, 3] = np.interp(times, rows[:, 0], rows[:, 1 + axis])
        result[~inside] = np.nan
        return result


def frame_name(name: str) -> str:
    """Return a frame's name without the leading slash of ROS 1."""
    return name.lstrip("/")


def seconds(stamp: Any) -> float:
    """Return a `builtin_interfaces/Time` [s]."""
    return float(stamp.sec + 1e-9 * stamp.nanosec)


def heading(quaternion: Any) -> float:
    """Return a quaternion's rotation about z after those about y and x [rad]; NaN if it is no rotation."""
    values = np.array([quaternion.x, quaternion.y, quaternion.z, quaternion.w], dtype=np.float64)
    return float(yaws(Rotation.from_quat(values).as_matrix())) if 0.0 < np.linalg.norm(values) < np.inf else np.nan


def yaws(matrices: np.ndarray) -> np.ndarray:
    """Return the rotations about z of rotations or poses, shape (..., 3 or 4, 3 or 4): shape (...) [rad]."""
    return np.asarray(np.arctan2(matrices[..., 1, 0], matrices[..., 0, 0]))


def _is_transform(rows: np.ndarray) -> np.ndarray:
    """Return which rows (..., 8) of stamp, position and quaternion are finite, and rotate."""
    norms = np.linalg.norm(rows[..., 4:], axis=-1)
    is_valid: np.ndarray = np.isfinite(rows).all(axis=-1) & (norms > 0.0) & (norms < np.inf)
    return is_valid

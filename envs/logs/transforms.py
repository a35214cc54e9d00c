"""Frames and transforms of ROS (tf2, REP 105)."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

MIN_UPRIGHT = 0.9
"""Least vertical part of the z axis of a lidar that scans a plane of the map: a tilt of 26 degrees."""


class FrameTree:
    """Frames by the transforms between them; of several for the same frame the first one counts."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, np.ndarray]] = {}

    def add(self, transforms: Iterable[Any]) -> None:
        """Add `geometry_msgs/TransformStamped` messages; ValueError if one is not finite, or no rotation."""
        for transform in transforms:
            child, parent = frame_name(transform.child_frame_id), frame_name(transform.header.frame_id)
            if child not in self._parents:
                self._parents[child] = parent, matrix(transform.transform)

    def find(self, base: str, frame: str) -> np.ndarray | None:
        """Return the pose of a frame in the base's frame, shape (4, 4); None if they are not connected."""
        base_root, base_pose = self._climb(base)
        root, pose = self._climb(frame)
        return np.linalg.inv(base_pose) @ pose if root == base_root else None

    def _climb(self, frame: str) -> tuple[str, np.ndarray]:
        """Return the root above a frame, and the frame's pose in it."""
        pose = np.eye(4)
        for _ in self._parents:  # transforms in a circle must not keep it climbing
            if frame not in self._parents:
                break
            frame, motion = self._parents[frame]
            pose = motion @ pose
        return frame, pose


def frame_name(name: str) -> str:
    """Return a frame's name without the leading slash of ROS 1."""
    return name.lstrip("/")


def matrix(transform: Any) -> np.ndarray:
    """Return a `geometry_msgs/Transform` as a matrix, shape (4, 4); ValueError if not finite, or no rotation."""
    t, result = transform.translation, np.eye(4)
    result[:3, :3] = _rotation(transform.rotation).as_matrix()
    result[:3, 3] = t.x, t.y, t.z
    if not np.isfinite(result).all():
        raise ValueError(f"translation ({t.x}, {t.y}, {t.z}) m is not finite")
    return result


def heading(quaternion: Any) -> float:
    """Return a quaternion's rotation about z after those about y and x [rad]; ValueError if not finite, or zero."""
    r = _rotation(quaternion).as_matrix()
    return float(np.arctan2(r[1, 0], r[0, 0]))


def planar_beams(pose: np.ndarray, first: float, step: float) -> tuple[float, float]:
    """Return the first beam's angle and the angle from beam to beam in the base frame, from those in the lidar's [rad].

    The lidar's `pose` in the base frame, shape (4, 4), may hang upside down.

    Raises:
        ValueError: the lidar is tilted.
    """
    if abs(pose[2, 2]) < MIN_UPRIGHT:
        tilt = np.degrees(np.arccos(np.clip(pose[2, 2], -1.0, 1.0)))
        raise ValueError(f"the lidar is tilted by {tilt:.0f} degrees, its scans are no planes of the map")
    sign = 1.0 if pose[2, 2] > 0.0 else -1.0
    return float(np.arctan2(pose[1, 0], pose[0, 0])) + sign * first, sign * step


def _rotation(quaternion: Any) -> Rotation:
    values = np.array([quaternion.x, quaternion.y, quaternion.z, quaternion.w], dtype=np.float64)
    if not 0.0 < np.linalg.norm(values) < np.inf:
        raise ValueError(f"quaternion {values.tolist()} is no rotation")
    return Rotation.from_quat(values)

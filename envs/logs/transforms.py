"""ROS transforms with lookup as in tf2 (REP 105)."""

import math
from array import array
from collections.abc import Iterable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from .bag_reader import BagReader
from .trajectory import MAX_CLOCK_JUMP

MAX_STAMP = 2.0**33
"""Upper bound of time stamps [s]; ROS has 32 bits for seconds."""
MIN_UPRIGHT = 0.9
"""Scans are dropped if the lidar tilts by more than 26 degrees: minimum absolute z component of its vertical axis."""
MIN_LEVEL = 0.996
"""A lidar tilt above 5 degrees gives a warning: minimum absolute z component of its vertical axis."""
UNIT_TOLERANCE = 0.01
"""Maximum error of a quaternion's squared norm, as in tf2."""
SAME_TRANSFORM = 1e-6
"""Transforms that vary by less count as constant [m, or quaternion component]."""


class FrameTree:
    """Tree of ROS coordinate frames with time-dependent transforms.

    The last static transform of a frame is valid at all times; dynamic transforms are interpolated. As in tf2,
    transforms that are not finite, not normalized, or from a frame to itself are ignored.
    """

    def __init__(self, max_rows: int | None = None) -> None:
        """Begin without transforms.

        `max_rows`: maximum number of kept transforms per pair of frames, for a robot that drives; they begin anew if
        the clock steps back.
        """
        self._max_rows = max_rows
        self._rows: dict[str, dict[str, array[float]]] = {}
        self._static: set[tuple[str, str]] = set()
        self.ignored: dict[str, int] = {}
        """Number of ignored transforms by frame."""

    def read(self, bag: BagReader, topics: Iterable[str], *, static: bool = False) -> None:
        """Read transforms from TFMessage or Odometry messages of a bag."""
        for topic in topics:
            for message in bag.messages(topic):
                for one in getattr(message, "transforms", (message,)):
                    self.add(one, static)

    def add(self, one: Any, static: bool = False) -> None:
        """Add a transform, or the pose of an Odometry message."""
        child, parent = frame_name(one.child_frame_id), frame_name(one.header.frame_id)
        if hasattr(one, "transform"):
            t, q, tolerance = one.transform.translation, one.transform.rotation, UNIT_TOLERANCE
        else:
            t, q, tolerance = one.pose.pose.position, one.pose.pose.orientation, math.inf
        norm = q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w
        row = [seconds(one.header.stamp), t.x, t.y, t.z, q.x, q.y, q.z, q.w]
        is_valid = all(map(math.isfinite, row)) and 0.0 < norm < math.inf and abs(norm - 1.0) <= tolerance
        if not is_valid or child == parent or (static and not parent):
            row = [row[0], *[math.nan] * 7]
        if static and is_valid and child != parent:
            self._static.add((child, parent))
        if (child, parent) not in self._static or static:
            rows = self._rows.setdefault(child, {}).setdefault(parent, array("d"))
            if self._max_rows is not None:
                has_stepped_back = len(rows) > 0 and row[0] < rows[-8] - MAX_CLOCK_JUMP
                del rows[: None if has_stepped_back else -8 * (self._max_rows - 1)]
            rows.extend(row)

    @property
    def frames(self) -> list[str]:
        return sorted({*self._rows, *(parent for parents in self._rows.values() for parent in parents)})

    def parents(self, frame: str) -> list[str]:
        """Return the parents of a frame (several if transforms conflict): static first, then the most frequent."""
        rows = self._rows.get(frame, {})
        return sorted(rows, key=lambda parent: ((frame, parent) not in self._static, -len(rows[parent])))

    def above(self, frame: str) -> list[str]:
        """Return the names of a frame and its ancestors up to the root."""
        names = [frame]
        while (parents := self.parents(names[-1])) and parents[0] not in names:  # stops at cycles
            names.append(parents[0])
        return names

    def stamps(self, frame: str, parent: str) -> np.ndarray:
        return np.array(self._rows[frame][parent]).reshape(-1, 8)[:, 0]

    def poses(self, frame: str, parent: str) -> tuple[np.ndarray, np.ndarray]:
        """Return time stamps, shape (n,) [s], and x, y, yaw of a frame in its parent, shape (n, 3) [m, m, rad]."""
        rows = self._valid(frame, parent)
        matrices = np.tile(np.eye(4), (len(rows), 1, 1))
        if len(rows):
            matrices[:, :3, :3] = Rotation.from_quat(rows[:, 4:]).as_matrix()
        matrices[:, :3, 3] = rows[:, 1:4]
        return rows[:, 0], planar(matrices)

    def find(self, base: str, frame: str, times: np.ndarray) -> np.ndarray | None:
        """Return poses of a frame in the base frame as matrices, shape (n, 4, 4), at `times`, shape (n,) [s].

        NaN at times without transform; None if the frames are not connected.
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
        pose = np.tile(np.eye(4), (len(times), 1, 1))
        for frame in chain:
            pose = self._at(frame, times) @ pose
        return pose

    def _valid(self, frame: str, parent: str) -> np.ndarray:
        rows = np.array(self._rows[frame][parent]).reshape(-1, 8)
        is_valid = np.isfinite(rows).all(axis=1)
        if not is_valid.all():
            self.ignored[frame] = int((~is_valid).sum())
        rows = rows[is_valid]
        if (frame, parent) in self._static:
            return rows[-1:]
        rows[:, 4:] *= np.where(rows[:, 4:] @ rows[0, 4:] < 0.0, -1.0, 1.0)[:, None] if len(rows) else 1.0
        _, first = np.unique(rows[:, 0], return_index=True)
        return rows[first]

    def _at(self, frame: str, times: np.ndarray) -> np.ndarray:
        rows, result = self._valid(frame, self.parents(frame)[0]), np.tile(np.eye(4), (len(times), 1, 1))
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


def frame_name(name: str | None) -> str:
    """Return a frame's name without the leading slash of ROS 1; empty for none."""
    return (name or "").lstrip("/")


def seconds(stamp: Any) -> float:
    """Return a ROS time stamp (`builtin_interfaces/Time`) in seconds; ValueError if out of its range."""
    time = float(stamp.sec + 1e-9 * stamp.nanosec)
    if not abs(time) < MAX_STAMP:
        raise ValueError(f"a stamp must be below {MAX_STAMP:g} s, got {time:g}")
    return time


def planar(matrices: np.ndarray) -> np.ndarray:
    """Convert poses from matrices, shape (n, 4, 4), to x, y, yaw, shape (n, 3) [m, m, rad]."""
    yaw = np.arctan2(matrices[:, 1, 0], matrices[:, 0, 0])
    return np.stack([matrices[:, 0, 3], matrices[:, 1, 3], yaw], axis=1)

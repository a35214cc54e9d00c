"""Contact of a circular footprint with segments and circles."""

import math
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from numba import njit

from envs.geometry import Pose2D
from envs.geometry.clearance import clearance, segment_offset
from envs.worlds import World

_MAX_PUSHES = 12
"""How often a footprint is pushed out of what it overlaps before it is taken to be wedged."""
_TOLERANCE = 1e-6
"""Overlap that counts as touching [m]."""
CONTACT_GAP = 0.01
"""Gap up to which a robot that has touched something touches what lies beside it [m]."""
_MIN_GAP = 1e-4
"""Least gap between the footprints of two robots at the start [m]."""


@njit(cache=True, error_model="numpy")
def select_near(x, y, reach, segments, near):
    """Write the indices of segments to `near`, among them all within `reach` [m] of (x, y); return how many.

    Those are taken whose bounding box comes that near: no division, and more than is near does no harm.
    """
    count = 0
    for i in range(segments.shape[0]):
        x0, y0, x1, y1 = segments[i, 0] - x, segments[i, 1] - y, segments[i, 2] - x, segments[i, 3] - y
        left, right = (x0 if x0 < x1 else x1), (x1 if x0 < x1 else x0)
        low, high = (y0 if y0 < y1 else y1), (y1 if y0 < y1 else y0)
        near[count] = i
        count += (left < reach) & (right > -reach) & (low < reach) & (high > -reach)
    return count


@njit(cache=True, error_model="numpy")
def push_out(x, y, radius, segments, near, num_near, circles, hits):
    """Push a circle out of what it overlaps, the deepest overlap first.

    Args:
        x: centre [m].
        y: centre [m].
        radius: of the circle that is pushed [m].
        segments: shape (n, 4), float64 [m].
        near: shape (>= num_near,), int64: the segments to consider.
        num_near: how many of them.
        circles: shape (m, 3), float64 [m].
        hits: shape (m,), bool: those of circles that push are set to True, the others stay as they are.

    Returns:
        The centre (x, y), whether anything was touched, and whether the circle is free now.
    """
    touched = False
    for _ in range(_MAX_PUSHES):
        deepest, push_x, push_y, hit = _TOLERANCE, 0.0, 0.0, -1
        for j in range(num_near):
            dx, dy = segment_offset(x, y, segments, near[j])
            distance = math.sqrt(dx * dx + dy * dy)
            if radius - distance > deepest and distance > 0.0:
                deepest, push_x, push_y = radius - distance, dx / distance, dy / distance
        for i in range(circles.shape[0]):
            dx, dy = x - circles[i, 0], y - circles[i, 1]
            distance = math.sqrt(dx * dx + dy * dy)
            if radius + circles[i, 2] - distance > deepest and distance > 0.0:
                deepest, push_x, push_y = radius + circles[i, 2] - distance, dx / distance, dy / distance
                hit = i
        if deepest == _TOLERANCE:
            return x, y, touched, True
        touched = True
        if hit >= 0:
            hits[hit] = True
        x, y = x + deepest * push_x, y + deepest * push_y
    return x, y, touched, False


def check_starts(poses: Sequence[Pose2D], radius: float, world: World) -> None:
    """Refuse starts where the robots do not fit.

    Args:
        poses: of the robots, world frame.
        radius: of their footprints [m].
        world: obstacles and movers at time 0.

    Raises:
        ValueError: a pose is not finite, or a footprint overlaps an obstacle or touches another footprint.
    """
    circles = world.circles_at(0.0)
    for pose in poses:
        if not np.all(np.isfinite(pose)):
            raise ValueError(f"start pose must be finite, got {pose}")
        free = clearance(pose.x, pose.y, world.segments, circles)
        if free < radius - _TOLERANCE:
            raise ValueError(
                f"the robot does not fit at x = {pose.x:.3f}, y = {pose.y:.3f} in world {world.name!r}: "
                f"its footprint has a radius of {radius:.3f} m, and the nearest obstacle is {max(free, 0.0):.3f} m away"
            )
    for b, second in enumerate(poses):
        for a, first in enumerate(poses[:b]):
            apart = math.dist(first[:2], second[:2])
            if apart <= 2.0 * radius + _MIN_GAP:
                raise ValueError(
                    f"robots {a} and {b} start {apart:.3f} m apart, but each has a footprint of {radius:.3f} m"
                )


class Contact(NamedTuple):
    """A contact of a robot at the end of a control period."""

    robot: int
    """Which robot."""
    kind: Literal["wall", "cylinder", "mover", "robot"]
    """What it touched."""
    which: int
    """Which one: row of `World.segments` or `World.circles`, of `World.movers`, or index of the other robot."""


def find_contacts(
    touched: Sequence[int], positions: np.ndarray, radius: float, world: World, circles: np.ndarray
) -> list[Contact]:
    """Return what robots touch: all that lies within `CONTACT_GAP` of the footprint, or else what is nearest.

    Args:
        touched: robots that touched anything during the period.
        positions: shape (num_robots, 2), float64, of all robots, world frame [m].
        radius: of their footprints [m].
        world: the world.
        circles: shape (m, 3), float64: static cylinders and then movers, as (x, y, radius) [m].
    """
    contacts = []
    num_static = len(world.circles)
    for k in touched:
        at = positions[k]
        others = [other for other in range(len(positions)) if other != k]
        around = np.hypot(*(circles[:, :2] - at).T) - circles[:, 2]
        peers = np.hypot(*(positions[others] - at).T) - radius
        gaps = np.concatenate([_distances(at, world.segments), around, peers]) - radius
        for i in np.flatnonzero(gaps <= max(CONTACT_GAP, gaps.min())).tolist():
            if i < len(world.segments):
                contacts.append(Contact(k, "wall", i))
            elif (j := i - len(world.segments)) < len(circles):
                kind: Any = "cylinder" if j < num_static else "mover"
                contacts.append(Contact(k, kind, j - num_static * (kind == "mover")))
            else:
                contacts.append(Contact(k, "robot", others[j - len(circles)]))
    return contacts


def _distances(point: np.ndarray, segments: np.ndarray) -> np.ndarray:
    """Return the distances from a point, shape (2,), to segments, shape (n, 4): shape (n,), float64 [m]."""
    along, to_point = segments[:, 2:] - segments[:, :2], point - segments[:, :2]
    share = (to_point * along).sum(axis=1) / np.maximum((along * along).sum(axis=1), 1e-300)
    distances: np.ndarray = np.hypot(*(to_point - np.clip(share, 0.0, 1.0)[:, None] * along).T)
    return distances

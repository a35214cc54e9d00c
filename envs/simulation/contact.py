"""Contact of circular robot footprints with obstacles, people and other robots."""

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.geometry.clearance import clearance, segment_offset
from lidarnaut.envs.worlds import World

from .crowd import person_row as crowd_at
from .records import TOUCHED_PERSON

_MAX_PUSHES = 12
_TOLERANCE = 1e-6
CONTACT_GAP = 0.01
"""Maximum gap from a colliding robot to objects that are reported as touched [m]."""
FAULT_SPEED = 0.05
"""Approach speed of a robot below which contact with a person is not the robot's fault [m/s]."""
_MIN_GAP = 1e-4


@njit(cache=True, error_model="numpy")
def select_near(x, y, reach, segments, near):
    """Find segments whose bounding boxes lie within `reach` [m] of the point (x, y), and return their number.

    `segments`: (x0, y0, x1, y1), shape (n, 4) [m]. `near`: output, indices of the segments, shape (n + 1,), int64.
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
    """Push a circle out of overlapping obstacles, the deepest overlap first.

    `segments`: walls, shape (n, 4), float64 [m]. `near`: indices of the walls to test, `num_near` in number. `circles`:
    (x, y, radius), shape (m, 3), float64 [m]. `hits`: shape (m,), bool; set to True for touched circles.

    Returns:
        Centre x, y, whether the circle touched anything, and whether no overlap remains.
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


@njit(cache=True, error_model="numpy")
def is_cut(pose, before, body, segments, circles):
    """Return True if a robot's body overlaps an obstacle, or has moved through one since the previous pose.

    `pose`, `before`: present and previous pose of the base. `body`: centre (x, y) in the base frame, and half length
    and half width of a box, or radius of a cylinder and 0 [m]. `segments`, `circles`: obstacles, shapes (n, 4) and (m,
    3) [m].
    """
    center_x, center_y, half_length, half_width = body
    c, s, c0, s0 = math.cos(pose[2]), math.sin(pose[2]), math.cos(before[2]), math.sin(before[2])
    x, y = pose[0] + c * center_x - s * center_y, pose[1] + s * center_x + c * center_y
    back_x, back_y = before[0] + c0 * center_x - s0 * center_y - x, before[1] + s0 * center_x + c0 * center_y - y
    reach = math.hypot(half_length, half_width)
    left, right = min(-reach, back_x), max(reach, back_x)
    low, high = min(-reach, back_y), max(reach, back_y)
    for i in range(segments.shape[0]):
        x0, y0, x1, y1 = segments[i, 0] - x, segments[i, 1] - y, segments[i, 2] - x, segments[i, 3] - y
        if max(x0, x1) < left or min(x0, x1) > right or max(y0, y1) < low or min(y0, y1) > high:
            continue
        dx, dy = x1 - x0, y1 - y0
        ends = (back_x * y0 - back_y * x0) * (back_x * y1 - back_y * x1)
        sides = (dy * x0 - dx * y0) * (dx * (back_y - y0) - dy * (back_x - x0))
        if ends <= 0.0 and sides < 0.0:
            return True
        if half_width == 0.0:
            away_x, away_y = segment_offset(x, y, segments, i)
            if away_x * away_x + away_y * away_y < half_length * half_length:
                return True
            continue
        along, across = c * dx + s * dy, c * dy - s * dx
        start_along, start_across = c * x0 + s * y0, c * y0 - s * x0
        # Intervals of the segment between opposite sides; infinite if parallel.
        a, b = (-half_length - start_along) / along, (half_length - start_along) / along
        e, f = (-half_width - start_across) / across, (half_width - start_across) / across
        if max(0.0, min(a, b), min(e, f)) < min(1.0, max(a, b), max(e, f)):
            return True
    for i in range(circles.shape[0]):
        dx, dy, radius = circles[i, 0] - x, circles[i, 1] - y, circles[i, 2]
        if dx + radius < left or dx - radius > right or dy + radius < low or dy - radius > high:
            continue
        share = (dx * back_x + dy * back_y) / max(back_x * back_x + back_y * back_y, 1e-300)
        share = min(max(share, 0.0), 1.0)
        if math.hypot(dx - share * back_x, dy - share * back_y) < radius:
            return True
        if half_width == 0.0:
            gap = math.hypot(dx, dy) - half_length
        else:
            gap = math.hypot(max(abs(c * dx + s * dy) - half_length, 0.0), max(abs(c * dy - s * dx) - half_width, 0.0))
        if gap < radius:
            return True
    return False


def check_starts(poses: Sequence[Pose2D], radius: float, world: World) -> None:
    """Check that robots with a footprint `radius` [m] do not collide at their start poses.

    Raises:
        ValueError: a pose is not finite, or a footprint overlaps an obstacle or another footprint.
    """
    circles = world.circles_at_start
    for pose in poses:
        if not np.all(np.isfinite(pose)):
            raise ValueError(f"start pose must be finite, got {pose}")
        free = clearance(pose.x, pose.y, world.segments, circles)
        if free < radius - _TOLERANCE:
            where = f"at x = {pose.x:.3f}, y = {pose.y:.3f} in world {world.name!r}"
            sizes = f"a radius of {radius:.3f} m, and the nearest obstacle is {max(free, 0.0):.3f} m away"
            raise ValueError(f"the robot does not fit {where}: its footprint has {sizes}")
    for b, second in enumerate(poses):
        for a, first in enumerate(poses[:b]):
            apart = math.dist(first[:2], second[:2])
            if apart <= 2.0 * radius + _MIN_GAP:
                size = f"each has a footprint radius of {radius:.3f} m"
                raise ValueError(f"robots {a} and {b} start {apart:.3f} m apart, but {size}")


Kind = Literal["wall", "cylinder", "person", "robot"]


class Contact(NamedTuple):
    """Contact between a robot and an object during a control period."""

    robot: int
    kind: Kind
    """Kind of the touched object: "wall", "cylinder", "person" or "robot"."""
    which: int
    """Index of the touched object in `World.segments`, `World.circles`, `Simulator.people` or among the robots."""
    by: Literal["robot", "other"] = "robot"
    """Cause of the contact: the robot or the touched object, whichever approached faster."""


@njit(cache=True, error_model="numpy")
def approach(row, x, y):
    """Return the commanded speed of a robot towards the point (x, y) [m/s]."""
    dx, dy = x - row.x, y - row.y
    return row.commanded_v * (dx * math.cos(row.theta) + dy * math.sin(row.theta)) / max(math.hypot(dx, dy), 1e-9)


@njit(cache=True, error_model="numpy")
def drove_into(row, person):
    """Return True if a robot caused contact with a person, by approaching faster than the person."""
    dx, dy = person[crowd_at.X] - row.x, person[crowd_at.Y] - row.y
    closing = -(person[crowd_at.VX] * dx + person[crowd_at.VY] * dy) / max(math.hypot(dx, dy), 1e-9)
    return approach(row, person[crowd_at.X], person[crowd_at.Y]) > max(closing, person[crowd_at.BLOCKED], FAULT_SPEED)


def find_contacts(rows: np.ndarray, world: World, people: np.ndarray) -> list[Contact]:
    """Return the contacts of all robots in the last control period.

    A robot in contact is reported to touch the nearest object and all objects within 1 cm. `rows`: records of robots.
    `people`: state vectors.
    """
    contacts = []
    positions, radius = np.stack([rows["x"], rows["y"]], axis=1), rows["radius"][0]
    bodies = people[:, [crowd_at.X, crowd_at.Y, crowd_at.RADIUS]]
    starts, along = world.segments[:, :2], world.segments[:, 2:] - world.segments[:, :2]
    for k in np.flatnonzero(rows["touched"] > 0.0).tolist():
        at, person = positions[k], int(rows["touched"][k]) - TOUCHED_PERSON
        share = ((at - starts) * along).sum(axis=1) / np.maximum((along * along).sum(axis=1), 1e-300)
        gaps: dict[Kind, np.ndarray] = {
            "wall": np.hypot(*(at - starts - np.clip(share, 0.0, 1.0)[:, None] * along).T) - radius,
            "cylinder": np.hypot(*(world.circles[:, :2] - at).T) - world.circles[:, 2] - radius,
            "person": np.hypot(*(bodies[:, :2] - at).T) - bodies[:, 2] - radius,
            "robot": np.hypot(*(positions - at).T) - 2.0 * radius,
        }
        gaps["robot"][k] = np.inf
        if person < 0:
            gaps["person"][:] = np.inf
        else:
            gaps["person"][person] = 0.0
        reach = max(CONTACT_GAP, min(each.min(initial=np.inf) for each in gaps.values()))
        for kind, each in gaps.items():
            for which in np.flatnonzero(each <= reach).tolist():
                is_others = kind == "person" and not drove_into(rows[k], people[which])
                if kind == "robot":
                    is_others = approach(rows[which], *at) > approach(rows[k], *positions[which])
                contacts.append(Contact(k, kind, which, "other" if is_others else "robot"))
    return contacts

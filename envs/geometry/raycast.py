"""Exact ray casting against line segments and circles."""

import math
from typing import NamedTuple

import numpy as np

from lidarnaut.envs.compilation import njit

_ANGLE_PADDING = 1e-3
"""Angle added on both sides of an obstacle's angular range, since polar angles are approximate [rad]."""
_TOUCH_TOLERANCE = 1e-9
"""Distance below which a sensor counts as lying on a wall, and all ranges are zero [m]."""


class Beams(NamedTuple):
    """Evenly spaced beams of a lidar, within one full turn."""

    angle_min: float
    """Angle of the first beam in the sensor frame [rad]."""
    angle_increment: float
    """Positive angle between neighbouring beams [rad]."""
    range_max: float
    """Maximum range [m]."""


@njit(cache=True, error_model="numpy", inline="always")
def polar(x: float, y: float) -> float:
    """Return the polar angle of the vector (x, y) in [0, 2 pi), with an error below 2e-5 rad.

    Polynomial of Hastings (Abramowitz and Stegun 4.4.49).
    """
    # `min` and `max` treat NaN in ways that prevent vectorisation.
    ax, ay = abs(x), abs(y)
    low, high = (ax if ax < ay else ay), (ay if ax < ay else ax)
    q = low / (high if high > 1e-300 else 1e-300)
    q2 = q * q
    a = q * (0.9998660 + q2 * (-0.3302995 + q2 * (0.1801410 + q2 * (-0.0851330 + q2 * 0.0208351))))
    a = 0.5 * math.pi - a if ay > ax else a
    a = math.pi - a if x < 0.0 else a
    return 2.0 * math.pi - a if y < 0.0 else a


@njit(cache=True, error_model="numpy")
def _segment_intervals(x, y, cos0, sin0, beams, segments, intervals):
    """Find the lidar beams that may hit each wall segment, for a sensor at (x, y) [m].

    `intervals`: output, shape (6, n): start point and direction vector of each segment [m], with x along the first
    beam; first beam and number of beams, negative if out of range.
    """
    start_x, start_y, along_x, along_y = intervals[0], intervals[1], intervals[2], intervals[3]
    first, span = intervals[4], intervals[5]
    for i in range(segments.shape[0]):
        px, py = segments[i, 0] - x, segments[i, 1] - y
        qx, qy = segments[i, 2] - x, segments[i, 3] - y
        start_x[i], start_y[i] = cos0 * px + sin0 * py, cos0 * py - sin0 * px
        along_x[i], along_y[i] = cos0 * (qx - px) + sin0 * (qy - py), cos0 * (qy - py) - sin0 * (qx - px)
    turn = 2.0 * math.pi
    beams_per_radian = 1.0 / beams.angle_increment
    range_max2 = beams.range_max * beams.range_max
    for i in range(segments.shape[0]):
        ax, ay, ex, ey = start_x[i], start_y[i], along_x[i], along_y[i]
        bx, by = ax + ex, ay + ey
        length2 = ex * ex + ey * ey
        nearest = -(ax * ex + ay * ey) / (length2 if length2 > 1e-300 else 1e-300)
        nearest = nearest if nearest > 0.0 else 0.0
        nearest = nearest if nearest < 1.0 else 1.0
        nx, ny = ax + nearest * ex, ay + nearest * ey
        distance2 = nx * nx + ny * ny
        counter_clockwise = ax * by - ay * bx >= 0.0
        angle_a, angle_b = polar(ax, ay), polar(bx, by)
        start = (angle_a if counter_clockwise else angle_b) - _ANGLE_PADDING
        sweep = (angle_b - angle_a if counter_clockwise else angle_a - angle_b) + 2.0 * _ANGLE_PADDING
        start = start + turn if start < 0.0 else start
        sweep = sweep + turn if sweep < 0.0 else sweep
        sweep = turn if distance2 < 1e-12 else sweep
        sweep = -beams.angle_increment if distance2 > range_max2 else sweep
        first[i] = start * beams_per_radian
        span[i] = sweep * beams_per_radian


@njit(cache=True, error_model="numpy")
def _hit_segment(low, high, segment, cosines, sines, out):
    ax, ay, ex, ey = segment
    area = ax * ey - ay * ex
    for k in range(low, high):
        dx, dy = cosines[k], sines[k]
        scale = 1.0 / (dx * ey - dy * ex)
        t = area * scale
        u = (ax * dy - ay * dx) * scale
        if t >= -_TOUCH_TOLERANCE and t < out[k] and u >= -_TOUCH_TOLERANCE and u <= 1.0 + _TOUCH_TOLERANCE:
            out[k] = max(t, 0.0)


@njit(cache=True, error_model="numpy")
def _hit_circle(low, high, circle, cosines, sines, out):
    cx, cy, radius = circle
    power = cx * cx + cy * cy - radius * radius
    for k in range(low, high):
        along = cosines[k] * cx + sines[k] * cy
        discriminant = along * along - power
        if discriminant >= 0.0:
            root = math.sqrt(discriminant)
            t = along - root if power > 0.0 else along + root
            if t >= 0.0 and t < out[k]:
                out[k] = t


@njit(cache=True, error_model="numpy")
def cast_rays(x, y, heading, beams, segments, circles, out):
    """Compute the ranges of evenly spaced lidar beams from a sensor at (x, y, heading) [m, m, rad].

    `beams`: `Beams` or a record with equal fields. `segments`: walls (x0, y0, x1, y1), shape (n, 4), float64 [m].
    `circles`: (x, y, radius), shape (m, 3), float64 [m]; a sensor inside a circle sees its far side. `out`: ranges,
    shape (num_beams,), float32 or float64 [m]; inf without a hit within `beams.range_max`.
    """
    num_beams = out.shape[0]
    turn = 2.0 * math.pi
    cos0, sin0 = math.cos(heading + beams.angle_min), math.sin(heading + beams.angle_min)
    increment, range_max = beams.angle_increment, beams.range_max
    cos_step, sin_step = math.cos(increment), math.sin(increment)
    cosines, sines, c, s = np.empty(num_beams), np.empty(num_beams), 1.0, 0.0
    for k in range(num_beams):
        cosines[k], sines[k] = c, s
        c, s = c * cos_step - s * sin_step, s * cos_step + c * sin_step
        out[k] = np.inf

    intervals = np.empty((6, segments.shape[0]))
    _segment_intervals(x, y, cos0, sin0, beams, segments, intervals)
    beams_per_turn = turn / increment
    for i in range(segments.shape[0]):
        first, span = intervals[4, i], intervals[5, i]
        if span < 0.0:
            continue
        segment = intervals[0, i], intervals[1, i], intervals[2, i], intervals[3, i]
        last = first + span
        low, high = math.ceil(first), min(int(last) + 1, num_beams)
        _hit_segment(low, high, segment, cosines, sines, out)
        if last >= beams_per_turn:
            high = min(int(last - beams_per_turn) + 1, num_beams)
            _hit_segment(0, high, segment, cosines, sines, out)

    for i in range(circles.shape[0]):
        px, py, radius = circles[i, 0] - x, circles[i, 1] - y, circles[i, 2]
        cx, cy = cos0 * px + sin0 * py, cos0 * py - sin0 * px
        distance = math.hypot(cx, cy)
        if distance - radius > range_max:
            continue
        if distance <= radius:
            _hit_circle(0, num_beams, (cx, cy, radius), cosines, sines, out)
            continue
        half = math.asin(radius / distance) + _ANGLE_PADDING
        start = polar(cx, cy) - half
        start = start + turn if start < 0.0 else start
        last_beam = (start + 2.0 * half) / increment
        low, high = math.ceil(start / increment), min(int(last_beam) + 1, num_beams)
        _hit_circle(low, high, (cx, cy, radius), cosines, sines, out)
        if last_beam >= beams_per_turn:
            high = min(int(last_beam - beams_per_turn) + 1, num_beams)
            _hit_circle(0, high, (cx, cy, radius), cosines, sines, out)

    for k in range(num_beams):
        if out[k] > range_max:
            out[k] = np.inf

"""Detection of person-sized clusters in scans, and tests for free space, compiled with Numba.

`p`: tracker parameters as floats; `scan`, `ranges`: shape (num_beams,), float32 [m].
"""

import math

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry.rows import write_row

from .scan_points import beam_end

CLUSTER_SIZE = 6
"""Number of values of a cluster: centre x, y [m], radius [m], number of beams, kind, and 1 if static."""
BODY, LEG, SLOPE, PART = 0.0, 1.0, 2.0, 3.0
"""Kinds of clusters: body of a person, leg, piece of a surface such as a wall, partly visible body."""
PASSED, HIDDEN, HIT = 1, 0, -1
"""Results of a free-space test of a disc (outline of a person): beams pass through the disc, the disc is occluded, or a
beam ends at the disc."""
JUMP, JUMP_ANGLE = 0.08, 0.35
"""Neighbouring scan points are in different clusters if farther apart than `JUMP` [m], plus a range-proportional
distance: minimum angle between beam and surface for neighbouring points of a surface to stay in one cluster [rad]
(lambda of Borges and Aldon, 2004)."""
SLOPE_STEP = 0.4
"""A cluster is part of a wall if the beam next to one of its ends is shorter than the end beam, by less than this
[m]."""
MAX_RANGE, MAX_SIZE, MIN_BEAMS = 8.0, 0.8, 3
"""Limits for clusters of people: maximum distance from the lidar and maximum extent [m], and minimum number of beams
for a track to start."""
LEG_SIZE, MAX_LEG_GAP = 0.25, 0.65
"""Maximum width of a leg, and maximum distance between the legs of a person [m]."""
CORE_SHARE = 0.8
"""Free-space tests of a person's disc cover this fraction of its radius, as walls may touch the rim."""
MAX_PART_SHARE = 0.75
"""Clusters with a radius below this fraction of a body's radius are taken for partly visible bodies."""
BODY_RADIUS, MAX_FLAT_RATIO, MIN_FLAT_SIZE, MIN_FLAT_BEAMS = 0.3, 0.27, 0.25, 8
"""Limits for clusters too flat to be a person, such as pieces of walls: radius of a body [m], maximum depth divided by
that of an arc with this radius, minimum width [m], minimum number of beams."""
ARC_DEPTH = 0.785
"""Distance from the mean of the scan points on a body to its centre, divided by its radius."""


@njit(cache=True, error_model="numpy")
def _is_slope(edge, neighbour):
    return edge - SLOPE_STEP < neighbour < edge


@njit(cache=True, error_model="numpy")
def _is_flat(x, y, first, last):
    chord_x, chord_y = last[0] - first[0], last[1] - first[1]
    chord = math.hypot(chord_x, chord_y)
    if chord < MIN_FLAT_SIZE:
        return False
    height = abs((x - first[0]) * chord_y - (y - first[1]) * chord_x) / chord
    radius = max(BODY_RADIUS, 0.5 * chord)
    return height < MAX_FLAT_RATIO * (radius - math.sqrt(radius * radius - 0.25 * chord * chord))


@njit(cache=True, error_model="numpy")
def _add_cluster(clusters, count, first, last, total, beams, is_slope, p):
    width = math.hypot(last[0] - first[0], last[1] - first[1])
    x, y = total[0] / beams, total[1] / beams
    ahead, left = x - p.mount_x, y - p.mount_y
    distance = math.hypot(ahead, left)
    width += distance * p.increment
    if width > MAX_SIZE or distance > MAX_RANGE or count == clusters.shape[0]:
        return count
    is_slope |= beams >= MIN_FLAT_BEAMS and _is_flat(x, y, first, last)
    radius = 0.5 * width
    depth = ARC_DEPTH * radius / max(distance, 1e-6)
    x, y = x + depth * ahead, y + depth * left
    is_part = radius < MAX_PART_SHARE * p.body_radius and beams > 1
    if is_part:
        # Partly occluded: centre of the circle through both ends.
        radius = p.body_radius
        chord_x, chord_y = last[0] - first[0], last[1] - first[1]
        squared = max(chord_x * chord_x + chord_y * chord_y, 1e-6)
        depth = math.sqrt(radius * radius / squared - 0.25)
        depth = depth if ahead * chord_y - left * chord_x < 0.0 else -depth
        x, y = 0.5 * (first[0] + last[0]) - depth * chord_y, 0.5 * (first[1] + last[1]) + depth * chord_x
    whole = PART if is_part else BODY
    kind = SLOPE if is_slope else (LEG if width < LEG_SIZE else whole)
    write_row(clusters[count], (x, y, radius, float(beams), kind, 0.0))
    return count + 1


@njit(cache=True, error_model="numpy")
def find_clusters(ranges, geometry, p, clusters):
    """Split a scan at large gaps between neighbouring points, write person-sized clusters, and return their number.

    Threshold for gaps: Borges and Aldon, "Line extraction in 2D range images for mobile robotics" (2004), equation 3.
    `clusters`: output, shape (n, CLUSTER_SIZE), float64.
    """
    num_beams, start = ranges.shape[0], 0
    gain = math.sin(p.increment) / math.sin(max(JUMP_ANGLE - p.increment, p.increment))
    count = beams = np.int64(0)  # typed, to avoid a second compilation
    if p.is_full_turn > 0.0:  # do not split a cluster at beam 0
        while start < num_beams and abs(ranges[start] - ranges[start - 1]) < 0.5:
            start += 1
    first = last = total = (0.0, 0.0)
    at, previous, is_slope = 0, np.inf, False
    for i in range(num_beams + 1):
        k = start + i if start + i < num_beams else start + i - num_beams  # faster than a remainder
        r = float(ranges[k]) if i < num_beams and not ranges[k] >= p.range_max else np.inf
        if not r > 0.0:
            continue
        point = beam_end(r, k, geometry) if r < np.inf else last
        reach = JUMP + (i - at) * gain * min(r, previous)
        if beams > 0 and (r == np.inf or (point[0] - last[0]) ** 2 + (point[1] - last[1]) ** 2 > reach * reach):
            is_slope |= _is_slope(previous, r)
            count = _add_cluster(clusters, count, first, last, total, beams, is_slope, p)
            beams = np.int64(0)
        if r < np.inf:
            if beams == 0:
                first, total, is_slope = point, (0.0, 0.0), _is_slope(r, previous)
            last, total, beams = point, (total[0] + point[0], total[1] + point[1]), beams + 1
        at, previous = i, r
    return count


@njit(cache=True, error_model="numpy")
def join_legs(clusters, count):
    """Merge each leg cluster with the nearest other leg cluster into a body; return the number of clusters."""
    i = 0
    while i < count:
        nearest, best = -1, MAX_LEG_GAP
        if clusters[i, 4] == LEG:
            for j in range(i + 1, count):
                gap = math.hypot(clusters[i, 0] - clusters[j, 0], clusters[i, 1] - clusters[j, 1])
                if clusters[j, 4] == LEG and gap < best:
                    nearest, best = j, gap
        if nearest >= 0:
            one, other = clusters[i], clusters[nearest]
            one[2] = 0.5 * best + max(one[2], other[2])
            one[0], one[1], one[4] = 0.5 * (one[0] + other[0]), 0.5 * (one[1] + other[1]), BODY
            one[3] += other[3]
            count -= 1
            write_row(other, clusters[count])
        i += 1
    return count


@njit(cache=True, error_model="numpy")
def look_at_disc(scan, pose, x, y, radius, margin, p):
    """Test whether a scan shows free space in a disc; return `PASSED` (free), `HIT` or `HIDDEN` (occluded).

    `pose`: lidar pose (x, y, theta), frame of the disc; `margin`: range tolerance [m].
    """
    dx, dy = x - pose[0], y - pose[1]
    distance = math.sqrt(dx * dx + dy * dy)
    if distance <= radius:
        return PASSED
    half = math.asin(CORE_SHARE * radius / distance) + 0.5 * p.increment
    middle = math.atan2(dy, dx) - pose[2] - p.angle_min
    if not 0.0 <= middle < 2.0 * math.pi:  # remainders are slow
        middle = middle + 2.0 * math.pi if -2.0 * math.pi < middle < 0.0 else middle % (2.0 * math.pi)
    low, high = math.ceil((middle - half) / p.increment), math.floor((middle + half) / p.increment)
    num_beams, passed, hidden = scan.shape[0], 0, 0
    near, far = distance - radius - margin, distance + CORE_SHARE * radius + margin
    for k in range(low, high + 1):
        if p.is_full_turn > 0.0:
            k += num_beams * (int(k < 0) - int(k >= num_beams))
        elif k < 0 or k >= num_beams:
            return HIDDEN
        r = float(scan[k])
        if r > far and (r < np.inf or p.range_max > far):
            passed += 1
        elif near <= r < np.inf:
            return HIT
        elif not math.isnan(r):
            hidden += 1
    return PASSED if passed > hidden else HIDDEN

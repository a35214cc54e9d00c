"""Slow reference of TinySLAM's map and matcher: doubles, dictionaries, one cell at a time."""

import math
from fractions import Fraction

import numpy as np

from lidarnaut.envs.robots import LidarParams, Mount

LIDAR = LidarParams(num_beams=40, range_max=2.5, fov=5.0, mount=Mount(x=0.12, y=-0.07, yaw=0.3))


def random_scan(rng):
    """Return ranges of `LIDAR`, including invalid, missing and short returns."""
    ranges = rng.uniform(0.05, 2.6, 40).astype(np.float32)
    ranges[:4] = np.nan, np.inf, 0.06, 1.0
    return ranges


def beams(ranges, pose, lidar, side, skip_exceeding):
    """Yield the first and the last cell (row, column) of each beam, and True for a hit."""
    base = pose.compose(type(pose)(lidar.mount.x, lidar.mount.y, lidar.mount.yaw))
    for r, angle in zip(ranges.tolist(), lidar.angles):
        if math.isnan(r) or (r >= lidar.range_max and skip_exceeding):
            continue
        reach = min(r, lidar.range_max)
        end = base.x + reach * math.cos(base.theta + angle), base.y + reach * math.sin(base.theta + angle)
        first, last = ((math.floor(y / side), math.floor(x / side)) for x, y in ((base.x, base.y), end))
        yield first, last, r < lidar.range_max


def line(first, last):
    """Cells (row, column) from first to last; a line exactly between two cells takes the cell nearer to its start."""
    d_row, d_col = last[0] - first[0], last[1] - first[1]
    length = max(abs(d_row), abs(d_col))
    cells = []
    for i in range(length + 1):
        part = Fraction(i, length) if length else Fraction(0)

        def along(start, distance, part=part):
            return start + int(math.copysign(math.ceil(abs(distance) * part - Fraction(1, 2)), distance))

        cells.append((along(first[0], d_row), along(first[1], d_col)))
    return cells


class ReferenceMap:
    """Maps (row, column) from the map frame's origin to [value, count]."""

    def __init__(self, params, lidar):
        self.params = params
        self.lidar = lidar
        self.cells = {}

    def draw(self, ranges, pose, quality):
        for first, last, hit in beams(ranges, pose, self.lidar, self.params.resolution, self.params.skip_exceeding):
            self._draw_beam(first, last, hit, quality)

    def _draw_beam(self, first, last, hit, quality):
        params = self.params
        hole = params.hole_width / params.resolution
        blurred = hit and hole**2 < (first[0] - last[0]) ** 2 + (first[1] - last[1]) ** 2
        for cell in line(first, last):
            prob = params.occupied_prob if hit and cell == last else params.empty_prob
            square = (cell[0] - last[0]) ** 2 + (cell[1] - last[1]) ** 2
            if blurred and 0 < square < hole**2:
                ramp = (1.0 - square / hole**2) * params.occupied_prob
                prob = min(prob + ramp, 1.0) if params.blur == "add" else ramp
            value, count = self.cells.get(cell, (0.5, 0))
            self.cells[cell] = (value * count + 0.5 + (prob - 0.5) * quality) / (count + 1), count + 1


def cost(values, points, x, y, theta, unvisited):
    """Scan cost at a pose: one minus the occupancy, summed over the hits, in single precision like the matcher.

    Args:
        values: shape (height, width), float64, occupancies, with the unvisited value if never observed.
        points: shape (2, n), float32, hits in the base frame [cells].
        x, y, theta: pose from the map's corner [cells, rad].
        unvisited: occupancy outside of the map.
    """
    height, width = values.shape
    c, s = np.float32(math.cos(theta)), np.float32(math.sin(theta))
    total = 0.0
    for px, py in points.T:
        col = math.floor(c * px - s * py + np.float32(x))
        row = math.floor(s * px + c * py + np.float32(y))
        inside = 0 <= row < height and 0 <= col < width
        total += 1.0 - (values[row, col] if inside else unvisited)
    return total


def search(values, points, pose, sigma_xy, sigma_theta, max_failed, max_tries, noise, unvisited):
    """Return (pose, cost, [(tested pose, its cost, accepted), ...])."""
    best_cost = cost(values, points, *pose, unvisited)
    tested = [(pose, best_cost, True)]
    failed = total = 0
    while failed < max_failed and total < max_tries:
        total += 1
        z = noise[total - 1]
        candidate = (pose[0] + sigma_xy * z[0], pose[1] + sigma_xy * z[1], pose[2] + sigma_theta * z[2])
        candidate_cost = cost(values, points, *candidate, unvisited)
        tested.append((candidate, candidate_cost, candidate_cost < best_cost))
        if best_cost <= candidate_cost:
            failed += 1
            continue
        best_cost, pose = candidate_cost, candidate
        if failed <= max_failed // 3:
            continue
        sigma_xy, sigma_theta, failed = 0.5 * sigma_xy, 0.5 * sigma_theta, 0
    return pose, best_cost, tested

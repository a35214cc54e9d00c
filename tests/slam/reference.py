"""TinySLAM's map and matcher once more, slow and plain: doubles, dictionaries, one cell at a time."""

import math
from fractions import Fraction

import numpy as np

UNVISITED = None


def line(first, last):
    """Cells (row, column) from first to last; a line right between two cells takes the one nearer to its start."""
    d_row, d_col = last[0] - first[0], last[1] - first[1]
    length = max(abs(d_row), abs(d_col))
    cells = []
    for i in range(length + 1):
        part = Fraction(i, length) if length else Fraction(0)

        def along(start, distance, part=part):
            return start + int(math.copysign(math.ceil(abs(distance) * part - Fraction(1, 2)), distance))

        cells.append((along(first[0], d_row), along(first[1], d_col)))
    return cells


def clip(polygon, a, b, c):
    """Return the part of a convex polygon where a x + b y <= c (Sutherland and Hodgman)."""
    kept = []
    for p, q in zip(polygon, polygon[1:] + polygon[:1]):
        at_p, at_q = a * p[0] + b * p[1] - c, a * q[0] + b * q[1] - c
        if at_p <= 0:
            kept.append(p)
        if (at_p < 0 < at_q) or (at_q < 0 < at_p):
            t = at_p / (at_p - at_q)
            kept.append((p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1])))
    return kept


def area(polygon):
    """Shoelace formula."""
    return 0.5 * abs(sum(p[0] * q[1] - q[0] * p[1] for p, q in zip(polygon, polygon[1:] + polygon[:1])))


def share(cell, a, b, c):
    """Share of a cell (row, column) in which a x + b y <= c."""
    row, col = cell
    return area(clip([(col, row), (col + 1, row), (col + 1, row + 1), (col, row + 1)], a, b, c))


def estimate(cell, start, end, hit, params):
    """Occupancy that a beam reports of a cell, and its weight; positions (x, y) in cells."""
    is_end = cell == (math.floor(end[1]), math.floor(end[0]))
    dx, dy = end[0] - start[0], end[1] - start[1]
    if params.estimator == "const":
        return (params.occupied_prob if hit and is_end else params.empty_prob), 1.0
    if hit and is_end:
        behind = 1.0 - share(cell, dx, dy, dx * end[0] + dy * end[1])
        return max(behind, params.empty_prob), 1.0
    left = share(cell, -dy, dx, dx * start[1] - dy * start[0])
    cut = min(left, 1.0 - left)
    return params.empty_prob, cut if cut > 1e-12 else 0.5


class ReferenceMap:
    """Maps (row, column) from the map frame's origin to [value, count]."""

    def __init__(self, params, lidar):
        self.params = params
        self.lidar = lidar
        self.cells = {}

    def draw(self, ranges, pose, quality):
        params, lidar, mount = self.params, self.lidar, self.lidar.mount
        base = pose.compose(type(pose)(mount.x, mount.y, mount.yaw))
        start = (base.x / params.resolution, base.y / params.resolution)
        for r, angle in zip(ranges.tolist(), lidar.angles):
            if math.isnan(r) or (r >= lidar.range_max and params.skip_exceeding):
                continue
            hit = r < lidar.range_max
            reach = min(r, lidar.range_max) / params.resolution
            end = (start[0] + reach * math.cos(base.theta + angle), start[1] + reach * math.sin(base.theta + angle))
            self._beam(start, end, hit, quality)

    def _beam(self, start, end, hit, quality):
        params = self.params
        first, last = ((math.floor(point[1]), math.floor(point[0])) for point in (start, end))
        hole = params.hole_width / params.resolution
        blurred = hit and hole**2 < (first[0] - last[0]) ** 2 + (first[1] - last[1]) ** 2
        hit_prob = estimate(last, start, end, True, params)[0]
        for cell in line(first, last):
            prob, weight = estimate(cell, start, end, hit, params)
            owed_to_hit = prob if hit and cell == last else 0.0
            square = (cell[0] - last[0]) ** 2 + (cell[1] - last[1]) ** 2
            if blurred and 0 < square < hole**2:
                owed_to_hit = (1.0 - square / hole**2) * hit_prob
                prob = min(prob + owed_to_hit, 1.0) if params.blur == "add" else owed_to_hit
            self._observe(cell, prob, weight * quality, owed_to_hit)

    def _observe(self, cell, prob, quality, owed_to_hit):
        value, count = self.cells.get(cell, (0.5, 0))
        if self.params.cell == "avg":
            seen = 0.5 + (prob - 0.5) * quality
            value = (value * count + seen) / (count + 1)
        elif self.params.cell == "base":
            value = (1.0 - quality) * value + quality * prob
        elif owed_to_hit > 0:
            value = value + (1.0 - value) * owed_to_hit
        else:
            value = value * (1.0 - prob)
        self.cells[cell] = (value, count + 1)


def cost(values, points, x, y, theta, unvisited):
    """Scan cost at a pose: one minus the occupancy, summed over the hits. Single precision, as the matcher has it.

    Args:
        values: shape (height, width), float64, occupancies, with the unvisited value where never observed.
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
    """The Monte Carlo matcher; returns (pose, cost, [(tested pose, its cost, accepted), ...])."""
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

"""Slow reference of TinySLAM's map and matcher: doubles, dictionaries, one cell at a time."""

import math
from fractions import Fraction

import numpy as np

from lidarnaut.envs.robots import LidarParams, Mount

LIDAR = LidarParams(num_beams=40, range_max=2.5, fov=5.0, mount=Mount(x=0.12, y=-0.07, yaw=0.3))


def random_scan(rng):
    """Return ranges of `LIDAR`, including invalid, missing and short returns."""
    ranges = rng.uniform(0.05, 2.6, 40).astype(np.float32)
    ranges[:6] = np.nan, np.inf, 0.06, 1.0, -np.inf, 0.0
    return ranges


def check_changed_cells(grid_map, ranges, pose, *quality):
    """Insert a scan; check the cells that the update names as changed, and return their number."""
    before = grid_map.grid.data.copy()
    update = grid_map.integrate(ranges, pose, *quality)
    after = grid_map.grid.data
    assert after.shape == before.shape
    changed = {tuple(cell) for cell in np.argwhere((before >= 0) & ((before >= 50) != (after >= 50))).tolist()}
    named = {tuple(cell) for cell in update.changed_cells.tolist()}
    assert changed <= named
    assert all(before[cell] >= 0 for cell in named - {tuple(cell) for cell in update.new_cells.tolist()})
    return len(changed)


def beams(ranges, pose, lidar, side, skip_exceeding):
    """Yield first and last cell (row, column), True for a hit, and start and end (x, y) in cells of each beam."""
    base = pose.compose(type(pose)(lidar.mount.x, lidar.mount.y, lidar.mount.yaw))
    for r, angle in zip(ranges.tolist(), lidar.angles):
        if not r > 0.0 or (r >= lidar.range_max and skip_exceeding):
            continue
        reach = min(r, lidar.range_max)
        end = base.x + reach * math.cos(base.theta + angle), base.y + reach * math.sin(base.theta + angle)
        first, last = ((math.floor(y / side), math.floor(x / side)) for x, y in ((base.x, base.y), end))
        yield first, last, r < lidar.range_max, ((base.x / side, base.y / side), (end[0] / side, end[1] / side))


def area_ahead(cell, point, direction):
    """Return the area of a unit cell (row, column) ahead of a line through a point, normal to a direction (x, y).

    0.5 if the line misses the cell. The cell is clipped as a polygon (Sutherland and Hodgman, 1974).
    """
    row, col = cell
    corners = [(col, row), (col + 1, row), (col + 1, row + 1), (col, row + 1)]
    ahead = [(x - point[0]) * direction[0] + (y - point[1]) * direction[1] for x, y in corners]
    kept = []
    for k in range(4):
        (x, y), (next_x, next_y), here, there = corners[k], corners[k - 3], ahead[k], ahead[k - 3]
        if here >= 0.0:
            kept.append((x, y))
        if here * there < 0.0:
            part = here / (here - there)
            kept.append((x + part * (next_x - x), y + part * (next_y - y)))
    if min(ahead) >= 0.0 or max(ahead) <= 0.0:
        return 0.5
    return 0.5 * abs(sum(a[0] * b[1] - b[0] * a[1] for a, b in zip(kept, [*kept[1:], kept[0]])))


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
        for beam in beams(ranges, pose, self.lidar, self.params.resolution, self.params.skip_exceeding):
            self._draw_beam(*beam, quality)

    def _draw_beam(self, first, last, hit, ends, quality):
        params, (start, end) = self.params, ends
        along = end[0] - start[0], end[1] - start[1]
        hit_prob, by_area = params.occupied_prob, params.occupancy_estimator == "area"
        if by_area:
            hit_prob = area_ahead(last, end, along)
        hole = params.hole_width / params.resolution
        blurred = hit and hole**2 < (first[0] - last[0]) ** 2 + (first[1] - last[1]) ** 2
        for cell in line(first, last):
            is_end, weight = hit and cell == last, quality
            prob = hit_prob if is_end else params.empty_prob
            square = (cell[0] - last[0]) ** 2 + (cell[1] - last[1]) ** 2
            if blurred and 0 < square < hole**2:
                ramp = (1.0 - square / hole**2) * hit_prob
                prob = min(prob + ramp, 1.0) if params.blur == "add" else ramp
            value, count = self.cells.get(cell, (0.5, 0))
            if by_area and not is_end:
                area = area_ahead(cell, start, (-along[1], along[0]))
                weight *= min(area, 1.0 - area)
            mean = (value * count + 0.5 + (prob - 0.5) * weight) / (count + 1)
            base = (1.0 - weight) * value + weight * prob
            self.cells[cell] = (base if params.cell_type == "base" else mean), count + 1


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

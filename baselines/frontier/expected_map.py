"""Expected map: the known map, and unknown cells near known floor that are predicted to be floor."""

import heapq
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from lidarnaut.envs.compilation import njit
from lidarnaut.envs.geometry import OCCUPIED_FROM, OccupancyGrid
from lidarnaut.envs.geometry.occupancy_grid import known_window
from lidarnaut.envs.navigation import Costmap
from lidarnaut.envs.navigation.maps.costmap import COST_INSCRIBED
from lidarnaut.envs.navigation.search.astar import COST_WEIGHT, SCALE, step_weights

MAX_SIDE = 0.2
"""Maximum side of a cell [m]."""
RADIUS_SHARE = 0.9
"""Maximum side of a cell, divided by the robot's radius: larger cells would connect both sides of a wall."""
PREDICTED_WEIGHT = 2 * SCALE
"""Weight of predicted floor in path search; that of known floor is `SCALE` far from obstacles."""
DIAGONAL = math.sqrt(2.0)


class Prediction(NamedTuple):
    """Probability that cells belong to the floor that the robot can explore, on a turned raster."""

    probability: np.ndarray
    """Shape (height, width), float32."""
    angle: float
    """Direction of the raster's rows, map frame [rad]."""
    corner: tuple[float, float]
    """Corner of cell (0, 0), in the map frame turned by `angle` [m]."""
    resolution: float
    """Side of a cell [m]."""


Predict = Callable[[OccupancyGrid], Prediction]
"""Function that predicts the floor around a map."""


class ExpectedMap(NamedTuple):
    """Known and predicted floor, on cells that join those of a costmap; arrays of shape (height, width)."""

    weights: np.ndarray
    """Weight of each cell in path search (see `step_weights`), uint8; 0 if not traversable."""
    clear: np.ndarray
    """Whether the lidar sees through a cell, bool."""
    expected: np.ndarray
    """Probability that an unknown cell is floor, float32; 0 for all that is not expected to be floor."""
    origin: tuple[float, float]
    """Corner of cell (0, 0), map frame [m]."""
    side: float
    """Side of a cell [m]."""
    num_known: int
    """Number of cells of known floor."""

    def cells(self, points: np.ndarray) -> np.ndarray:
        """Return the cells (row, column) of points (x, y), shape (n, 2), map frame [m]: shape (n, 2), int64."""
        return np.floor((points[:, ::-1] - self.origin[::-1]) / self.side).astype(np.int64)

    def centers(self, cells: np.ndarray) -> np.ndarray:
        """Return the centres (x, y) of cells (row, column), shape (n, 2): shape (n, 2), float64, map frame [m]."""
        centers: np.ndarray = self.origin + (cells[:, ::-1] + 0.5) * self.side
        return centers


@njit(cache=True, error_model="numpy")
def _join(occupancy, costs, window, factor, table):
    row0, col0, height, width = window
    weights, clear = np.zeros((height, width), dtype=np.uint8), np.zeros((height, width), dtype=np.bool_)
    state = np.full((height, width), -1, dtype=np.int8)  # -2: unknown, and too near to an obstacle for the robot
    for row in range(height):
        for col in range(width):
            top, left, lowest = (row0 + row) * factor, (col0 + col) * factor, 255
            for i in range(max(top, 0), min(top + factor, occupancy.shape[0])):
                for j in range(max(left, 0), min(left + factor, occupancy.shape[1])):
                    value = occupancy[i, j]
                    state[row, col] = max(state[row, col], 1 if value >= OCCUPIED_FROM else 0 if value >= 0 else -1)
                    lowest = min(lowest, costs[i, j])
            clear[row, col] = state[row, col] == 0
            if state[row, col] >= 0 and lowest < COST_INSCRIBED:
                weights[row, col] = table[lowest]
            elif state[row, col] < 0 and lowest == COST_INSCRIBED:
                state[row, col] = -2
    return weights, clear, state


@njit(cache=True, error_model="numpy")
def _predict(state, frame, probability, turned, threshold):
    (x0, y0, side), (angle, left, bottom, resolution) = frame, turned
    cosine, sine = math.cos(angle), math.sin(angle)
    expected = np.zeros(state.shape, dtype=np.float32)
    for row in range(state.shape[0]):
        for col in range(state.shape[1]):
            x, y = x0 + (col + 0.5) * side, y0 + (row + 0.5) * side
            i = math.floor((cosine * y - sine * x - bottom) / resolution)
            j = math.floor((cosine * x + sine * y - left) / resolution)
            is_inside = 0 <= i < probability.shape[0] and 0 <= j < probability.shape[1]
            if is_inside and state[row, col] < 0 and probability[i, j] >= threshold:
                expected[row, col] = probability[i, j]
    return expected


@njit(cache=True, error_model="numpy")
def spread(weights, sources, reach, cuts_corners):
    """Return the nearest source of each cell, -1 for none, and the path length to it [free cells] (Dijkstra 1959).

    `weights`: those of `ExpectedMap`; sources need not be traversable. `sources`: cells (row, column), shape (n, 2),
    int64. `reach`: maximum path length. `cuts_corners`: whether diagonal steps may pass cells of weight 0.
    """
    height, width = weights.shape
    owners, lengths = np.full((height, width), -1, dtype=np.int32), np.full((height, width), np.float32(np.inf))
    queue = [(np.float32(0.0), 0, 0)]
    queue.clear()
    for k in range(len(sources)):
        row, col = sources[k]
        if owners[row, col] < 0:
            owners[row, col], lengths[row, col] = k, 0.0
            queue.append((np.float32(0.0), row, col))
    while len(queue):
        length, row, col = heapq.heappop(queue)
        if length > lengths[row, col]:
            continue
        for i in range(max(row - 1, 0), min(row + 2, height)):
            for j in range(max(col - 1, 0), min(col + 2, width)):
                is_straight = i == row or j == col
                is_open = is_straight or cuts_corners or (weights[row, j] > 0 and weights[i, col] > 0)
                if weights[i, j] == 0 or not is_open:
                    continue
                onward = np.float32(length + (1.0 if is_straight else DIAGONAL) * weights[i, j] / SCALE)
                if onward <= reach and onward < lengths[i, j]:
                    owners[i, j], lengths[i, j] = owners[row, col], onward
                    heapq.heappush(queue, (onward, i, j))
    return owners, lengths


def expect_map(costmap: Costmap, prediction: Prediction, reach: float, threshold: float) -> ExpectedMap:
    """Return the expected map for a costmap.

    Unknown cells count as floor if their probability is at least `threshold`, and a path over such cells, at most
    `reach` long [m], leads to known floor.
    """
    grid, known = costmap.grid, known_window(costmap.grid.data)
    factor = max(1, int(min(RADIUS_SHARE * costmap.params.robot_radius, MAX_SIDE + 1e-9) / grid.resolution))
    side = factor * grid.resolution
    margin = math.ceil(reach / side) + 1
    top, left = known.row // factor - margin, known.col // factor - margin
    height = (known.row + known.height - 1) // factor + margin + 1 - top
    width = (known.col + known.width - 1) // factor + margin + 1 - left
    table = step_weights(COST_WEIGHT, False)
    weights, clear, state = _join(grid.data, costmap.costs, (top, left, height, width), factor, table)
    origin = grid.origin[0] + left * side, grid.origin[1] + top * side
    turned = prediction.angle, *prediction.corner, prediction.resolution
    expected = _predict(state, (*origin, side), prediction.probability, turned, threshold)
    near, known_floor = SCALE * (expected > 0.0).astype(np.uint8), np.column_stack(np.nonzero(state == 0))
    expected[spread(near, known_floor, reach / side, True)[0] < 0] = 0.0
    clear |= expected > 0.0
    weights[(expected > 0.0) & (state == -1)] = PREDICTED_WEIGHT
    return ExpectedMap(weights, clear, expected, origin, side, int(np.count_nonzero(state == 0)))

"""NumPy implementations of compiled kernels, for comparison."""

import math

import numpy as np

from lidarnaut.envs.geometry import OCCUPIED_FROM, wrap_angle
from lidarnaut.envs.robots import RobotParams


def pool_in_numpy(data: np.ndarray, visited: np.ndarray, block: int) -> np.ndarray:
    """Downsample an occupancy grid, shape (height, width), int8, to coarse cells of `block` x `block` grid cells.

    Returns shape (3, rows, columns), uint8: contains an occupied cell, share of free cells, visited by the robot.
    `visited` are grid cells (row, column), shape (n, 2).
    """
    rows, cols = -(-data.shape[0] // block), -(-data.shape[1] // block)
    margins = ((0, rows * block - data.shape[0]), (0, cols * block - data.shape[1]))
    padded = np.pad(data, margins, constant_values=-1).reshape(rows, block, cols, block)
    free = ((padded >= 0) & (padded < OCCUPIED_FROM)).sum(axis=(1, 3))
    pooled = np.zeros((3, rows, cols), dtype=np.uint8)
    pooled[0] = 255 * (padded >= OCCUPIED_FROM).any(axis=(1, 3))
    pooled[1] = 255 * free // block**2
    pooled[2][tuple(visited.T // block)] = 255
    return pooled


def crop_in_numpy(pooled: np.ndarray, x: float, y: float, theta: float, pixel: float, size: int) -> np.ndarray:
    """Return a map crop centred on and aligned with the robot: shape (channels, size, size), uint8; 0 outside the map.

    `pooled`: downsampled map, shape (channels, rows, columns). `x`, `y`, `pixel`: robot position and pixel size
    [cells].
    """
    c, s = math.cos(theta), math.sin(theta)
    steps = (np.arange(size) - 0.5 * size + 0.5) * pixel
    ahead, left = steps[:, None], steps
    cols = np.floor(x + c * ahead - s * left).astype(np.int32)
    rows = np.floor(y + s * ahead + c * left).astype(np.int32)
    inside = (rows >= 0) & (rows < pooled.shape[1]) & (cols >= 0) & (cols < pooled.shape[2])
    indices = rows * pooled.shape[2] + cols
    return np.where(inside, pooled.reshape(len(pooled), -1).take(indices, axis=1, mode="clip"), np.uint8(0))


def advance_in_numpy(
    state: np.ndarray, command: tuple[float, float], normals: tuple[float, float], period: float, substeps: int,
    robot: RobotParams, segments: np.ndarray, circles: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """Return a robot's state after driving among static obstacles for one `period` [s]: shape (11,), float64.

    The state is pose, commanded twist, wheel angles, true twist, mean yaw rate and gyroscope bias. `normals` are
    standard normal samples of left and right wheel slip.
    """
    x, y, theta, v, w, left_angle, right_angle, _, _, _, bias = state.tolist()
    turned = 0.0
    dt, wheels, assumed = period / substeps, robot.drive, robot.odometry
    target_v = min(max(command[0], -robot.max_v), robot.max_v)
    target_w = min(max(command[1], -robot.max_w), robot.max_w)
    change_v, change_w = robot.max_acc_v * dt, robot.max_acc_w * dt
    for _ in range(substeps):
        v += min(max(target_v - v, -change_v), change_v)
        w += min(max(target_w - w, -change_w), change_w)
        rates = np.array([v - 0.5 * w * assumed.track, v + 0.5 * w * assumed.track]) / assumed.wheel_radius
        rolled = rates * dt * wheels.wheel_radius
        rolled += wheels.slip_std * np.sqrt(np.abs(rolled) / substeps) * normals
        turn, distance = float(rolled[1] - rolled[0]) / wheels.track, float(rolled.mean())
        chord = distance * (math.sin(0.5 * turn) / (0.5 * turn) if turn != 0.0 else 1.0)
        c, s = math.cos(theta + 0.5 * turn), math.sin(theta + 0.5 * turn)
        new_x, new_y = _push_out(x + chord * c, y + chord * s, robot.radius, segments, circles) or (x, y)
        turned += turn
        true_v, true_w = ((new_x - x) * c + (new_y - y) * s) / dt, turn / dt
        x, y, theta = new_x, new_y, float(wrap_angle(theta + turn))
        left_angle, right_angle = left_angle + float(rates[0]) * dt, right_angle + float(rates[1]) * dt
    return np.array([x, y, theta, v, w, left_angle, right_angle, true_v, true_w, turned / period, bias])


def _push_out(
    x: float, y: float, radius: float, segments: np.ndarray, circles: np.ndarray
) -> tuple[float, float] | None:
    starts, along = segments[:, :2], segments[:, 2:] - segments[:, :2]
    lengths2 = np.maximum((along**2).sum(axis=1), 1e-300)
    reach = np.concatenate([np.full(len(segments), radius), radius + circles[:, 2]])
    at = np.array([x, y])
    for _ in range(12):
        shares = np.clip(((at - starts) * along).sum(axis=1) / lengths2, 0.0, 1.0)
        offsets = np.vstack([at - starts - shares[:, None] * along, at - circles[:, :2]])
        distances = np.hypot(offsets[:, 0], offsets[:, 1])
        depths = reach - distances
        deepest = int(depths.argmax())
        if depths[deepest] <= 1e-6:
            return float(at[0]), float(at[1])
        at = at + depths[deepest] / distances[deepest] * offsets[deepest]
    return None

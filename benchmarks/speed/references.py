"""What kernels compute, once more in plain NumPy."""

import math

import numpy as np

from envs.geometry import Pose2D, wrap_angle
from envs.observation import OCCUPIED_FROM, SAMPLES
from envs.robots import RobotParams


def cast_rays_in_numpy(
    x: float, y: float, angles: np.ndarray, range_max: float, segments: np.ndarray, circles: np.ndarray
) -> np.ndarray:
    """Test every beam against every segment and circle, from outside the circles; see `cast_rays`.

    Args:
        x: position of the sensor [m].
        y: the same [m].
        angles: shape (num_beams,), directions of the beams, world frame [rad].
        range_max: farthest return [m].
        segments: shape (n, 4) [m].
        circles: shape (m, 3) [m].

    Returns:
        Shape (num_beams,), float64, inf for no return.
    """
    c, s = np.cos(angles)[:, None], np.sin(angles)[:, None]
    ax, ay = segments[:, 0] - x, segments[:, 1] - y
    ex, ey = segments[:, 2] - segments[:, 0], segments[:, 3] - segments[:, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = 1.0 / (c * ey - s * ex)
        t, u = (ax * ey - ay * ex) * scale, (ax * s - ay * c) * scale
        nearest = np.where((t >= 0.0) & (u >= 0.0) & (u <= 1.0), t, np.inf).min(axis=1, initial=np.inf)
        cx, cy = circles[:, 0] - x, circles[:, 1] - y
        along = c * cx + s * cy
        t = along - np.sqrt(along**2 - (cx**2 + cy**2 - circles[:, 2] ** 2))
        nearest = np.minimum(nearest, np.where(t >= 0.0, t, np.inf).min(axis=1, initial=np.inf))
    nearest[nearest > range_max] = np.inf
    return nearest


def crop_map_in_numpy(
    data: np.ndarray,
    origin: tuple[float, float],
    resolution: float,
    pose: Pose2D,
    pixel: float,
    trail: np.ndarray,
    size: int,
) -> np.ndarray:
    """Look at the map from the robot; see `envs.observation.crop_map`.

    Args:
        data: shape (height, width), int8, occupancy.
        origin: corner of cell (0, 0), map frame [m].
        resolution: side of a map cell [m].
        pose: of the robot, map frame.
        pixel: side of a crop pixel [m].
        trail: shape (n, 2), past positions, map frame [m].
        size: side of the crop [pixels].

    Returns:
        Shape (3, size, size), uint8.
    """
    c, s = math.cos(pose.theta), math.sin(pose.theta)
    steps = ((np.arange(size * SAMPLES) + 0.5) / SAMPLES - 0.5 * size) * (pixel / resolution)
    ahead, left = steps[:, None], steps
    cols = np.floor((pose.x - origin[0]) / resolution + c * ahead - s * left).astype(np.int32)
    rows = np.floor((pose.y - origin[1]) / resolution + s * ahead + c * left).astype(np.int32)
    height, width = data.shape
    inside = (rows >= 0) & (rows < height) & (cols >= 0) & (cols < width)
    values = np.where(inside, data.take(rows * width + cols, mode="clip"), -1)
    values = values.reshape(size, SAMPLES, size, SAMPLES)
    crop = np.zeros((3, size, size), dtype=np.uint8)
    crop[0] = 255 * (values >= OCCUPIED_FROM).any(axis=(1, 3))
    crop[1] = 255 * ((values >= 0) & (values < OCCUPIED_FROM)).sum(axis=(1, 3)) // SAMPLES**2
    pixels = np.floor(pose.inverse().transform(trail) / pixel + 0.5 * size).astype(np.int64)
    pixels = pixels[((pixels >= 0) & (pixels < size)).all(axis=1)]
    crop[2, pixels[:, 0], pixels[:, 1]] = 255
    return crop


def advance_in_numpy(
    state: np.ndarray,
    command: tuple[float, float],
    normals: tuple[float, float],
    period: float,
    substeps: int,
    robot: RobotParams,
    segments: np.ndarray,
    circles: np.ndarray,
) -> np.ndarray:
    """Move a robot among things that stand still; see `envs.simulation.kinematic.advance`.

    Args:
        state: shape (9,), as there.
        command: twist [m/s, rad/s].
        normals: standard normal draws for the slip of the left and the right wheel.
        period: control period [s].
        substeps: into how many equal parts it is cut.
        robot: who.
        segments: shape (n, 4) [m].
        circles: shape (m, 3) [m].

    Returns:
        Shape (9,), the state after the period.
    """
    x, y, theta, v, w, left_angle, right_angle, _, _ = state.tolist()
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
        true_v, true_w = ((new_x - x) * c + (new_y - y) * s) / dt, turn / dt
        x, y, theta = new_x, new_y, float(wrap_angle(theta + turn))
        left_angle, right_angle = left_angle + float(rates[0]) * dt, right_angle + float(rates[1]) * dt
    return np.array([x, y, theta, v, w, left_angle, right_angle, true_v, true_w])


def _push_out(
    x: float, y: float, radius: float, segments: np.ndarray, circles: np.ndarray
) -> tuple[float, float] | None:
    """Push a footprint out of what it overlaps, the deepest overlap first; None if it stays wedged."""
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

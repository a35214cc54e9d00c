"""Scans of simple shapes, for tests of matching."""

import numpy as np

from envs.slam.matching.submap_field import Scans


def visible_points(segments, pose, angles, max_range, rng=None):
    """Return hits of beams on wall segments, shape (n, 2), float32, in the frame of the pose [m].

    Args:
        segments: shape (k, 4), x0, y0, x1, y1 [m].
        pose: x, y, heading of the lidar [m, m, rad].
        angles: of the beams [rad].
        max_range: farthest return [m].
        rng: for noise of 1 cm; None for none.
    """
    start, end = segments[:, :2], segments[:, 2:]
    points = []
    for angle in angles:
        d = np.array([np.cos(pose[2] + angle), np.sin(pose[2] + angle)])
        along = end - start
        det = along[:, 0] * d[1] - along[:, 1] * d[0]
        with np.errstate(divide="ignore", invalid="ignore"):
            offset = start - np.array(pose[:2])
            t = (along[:, 0] * offset[:, 1] - along[:, 1] * offset[:, 0]) / det
            u = (d[0] * offset[:, 1] - d[1] * offset[:, 0]) / det
        t = t[(t > 0.0) & (u >= 0.0) & (u <= 1.0) & np.isfinite(t)]
        if len(t) and t.min() < max_range:
            r = t.min() + (0.01 * rng.standard_normal() if rng is not None else 0.0)
            points.append([r * np.cos(angle), r * np.sin(angle)])
    return np.array(points, dtype=np.float32).reshape(-1, 2)


def rectangle(x0, y0, x1, y1):
    """Return the four walls of a rectangle, shape (4, 4)."""
    return np.array([[x0, y0, x1, y0], [x1, y0, x1, y1], [x1, y1, x0, y1], [x0, y1, x0, y0]], dtype=float)


ROOM = np.concatenate([rectangle(0.0, 0.0, 6.0, 4.0), rectangle(4.0, 1.0, 4.6, 1.5), [[2.0, 4.0, 2.0, 2.8]]])
"""A room of 6 m x 4 m with a box and a partition, shape (9, 4) [m]."""


def take_scans(segments, poses, num_beams=180, max_range=10.0, seed=0):
    """Return `Scans` of wall segments from poses, shape (n, 3)."""
    rng = np.random.default_rng(seed)
    angles = np.linspace(-np.pi, np.pi, num_beams, endpoint=False)
    points = [visible_points(segments, pose, angles, max_range, rng) for pose in poses]
    ends = np.cumsum([len(each) for each in points])
    spans = np.stack([ends - [len(each) for each in points], ends], axis=1)
    return Scans(np.concatenate(points), spans, np.array(poses, dtype=float), 0.0, 0.0)

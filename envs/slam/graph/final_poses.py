"""Matching nodes with the map that is rendered from all of them."""

import numpy as np

from envs.geometry import Pose2D
from envs.robots import LidarParams
from envs.slam.matching.gauss_newton import refine
from envs.slam.matching.scan_matcher import make_prior
from envs.slam.scans import project_hits

from .nodes import NodeStore
from .params import GraphSlamParams
from .rendering import MapRendering

STDS = np.array([0.05, 0.05, 0.01])
"""Standard deviations of nodes' poses before they are matched [m, m, rad]."""


def refine_poses(params: GraphSlamParams, lidar: LidarParams, nodes: NodeStore, poses: np.ndarray) -> np.ndarray:
    """Return where the nodes fit the map of all of them best, near their poses.

    Args:
        params: of the SLAM.
        lidar: geometry of the scans.
        nodes: with their scans.
        poses: shape (num_nodes, 3), float64, of nodes, map frame [m, m, rad].

    Returns:
        Shape (num_nodes, 3), float64.
    """
    map, refined = MapRendering(params, lidar).add_all(nodes, poses), np.array(poses)
    points, resolution = np.empty((2, lidar.num_beams), dtype=np.float32), params.resolution
    covariance, variance = np.diag(STDS**2), float(params.residual_variance)
    for k in range(len(poses)):
        count = project_hits(nodes.ranges[k], map.geometry, points)
        x, y, theta = poses[k].tolist()
        start = (*map.to_cells(x, y), theta)
        prior = make_prior(start, covariance, variance, resolution)
        x, y, theta, _ = refine(map.levels, points, count, start, prior, params.iterations, params.coarse_iterations)
        refined[k] = Pose2D(*map.to_metres(x, y), theta)
    return refined

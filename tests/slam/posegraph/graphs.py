"""Graphs of laps with loop closures, whose poses have drifted."""

import math

import numpy as np

from envs.geometry import Pose2D
from envs.slam.posegraph import PoseGraph

SPACING, TURN = 20, 40
"""Nodes from one submap to the next, and nodes that a submap takes."""
SIGMAS = np.array([0.03, 0.03, 0.008])
"""Noise of constraints [m, m, rad]."""
DRIFT = np.array([0.005, 0.005, 0.004])
"""Noise of odometry from node to node [m, m, rad]."""


def drive(num_nodes: int, step: float = 0.2) -> np.ndarray:
    """Return true poses along laps of an oval, shape (num_nodes, 3) [m, m, rad]."""
    poses = [Pose2D(0.0, 0.0, 0.0)]
    for k in range(num_nodes - 1):
        turn = math.pi / 20 if k % 100 >= 80 else 0.0
        poses.append(poses[-1].compose(Pose2D(step, 0.0, turn)))
    return np.array(poses)


def make_graph(
    num_nodes: int, num_loops: int, num_outliers: int, rng: np.random.Generator
) -> tuple[PoseGraph, np.ndarray]:
    """Return a graph whose poses have drifted, and the true poses of its nodes, shape (num_nodes, 3)."""
    truth = [Pose2D(*row) for row in drive(num_nodes).tolist()]
    graph, covariance, pose = PoseGraph(), np.diag(SIGMAS**2), truth[0]
    for k in range(num_nodes):
        if k:
            motion = np.array(truth[k - 1].between(truth[k])) + DRIFT * rng.standard_normal(3)
            pose = pose.compose(Pose2D(*motion.tolist()))
        if k % SPACING == 0:
            graph.add_submap(pose)
        graph.add_node(pose)
        for submap in range(max(k // SPACING - TURN // SPACING + 1, 0), k // SPACING + 1):
            relative = np.array(truth[submap * SPACING].between(truth[k])) + SIGMAS * rng.standard_normal(3)
            graph.add_constraint(k, submap, relative, covariance)
    xy = np.array(truth)[:, :2]
    pairs = [
        (k, submap)
        for k in range(num_nodes)
        for submap in range(k // SPACING - 3)
        if np.hypot(*(xy[submap * SPACING] - xy[k])) < 4.0
    ]
    for k, submap in rng.permutation(pairs)[:num_loops].tolist() if pairs else []:
        relative = np.array(truth[submap * SPACING].between(truth[k])) + SIGMAS * rng.standard_normal(3)
        graph.add_constraint(k, submap, relative, covariance, is_loop=True)
    for _ in range(num_outliers):
        k, submap = int(rng.integers(num_nodes // 2, num_nodes)), int(rng.integers(num_nodes // SPACING // 4))
        wrong = rng.uniform([-4.0, -4.0, -0.5], [4.0, 4.0, 0.5])
        graph.add_constraint(k, submap, wrong, covariance, is_loop=True)
    return graph, np.array(truth)

"""Time of pose graph optimisation: `python -m benchmarks.posegraph`.

A robot drives laps, its pose drifts, and loop closures constrain it to submaps of earlier laps. Printed are the time of
one iteration and of the whole optimisation, the least of all repetitions and the median, on one core.
"""

import math
import time
from dataclasses import dataclass

import numpy as np
import tyro

from envs.geometry import Pose2D
from envs.slam.posegraph import PoseGraph, optimise, optimise_step

SPACING, TURN = 20, 40
"""Nodes from one submap to the next, and nodes that a submap takes."""
SIGMAS = np.array([0.03, 0.03, 0.008])
"""Noise of constraints [m, m, rad]."""
DRIFT = np.array([0.005, 0.005, 0.004])
"""Noise of odometry from node to node [m, m, rad]."""


@dataclass(frozen=True)
class Options:
    """Time the optimisation of a pose graph."""

    nodes: int = 2000
    """Number of nodes; a submap starts every 20."""
    loops: int = 1000
    """Number of loop constraints."""
    outliers: int = 0
    """Number of loop constraints that are wrong."""
    repetitions: int = 50
    """Number of times that everything is measured."""


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


def main(options: Options) -> None:
    graph, truth = make_graph(options.nodes, options.loops, options.outliers, np.random.default_rng(0))
    arrays = graph.arrays
    submaps, nodes = arrays.submaps.copy(), arrays.nodes.copy()
    times: dict[str, list[float]] = {"one iteration": [], "optimisation": []}
    iterations = 0
    for k in range(options.repetitions + 1):
        for name, call in (
            ("one iteration", lambda: optimise_step(arrays, 9.0)),
            ("optimisation", lambda: optimise(arrays, 9.0, 5, 1e-4)),
        ):
            arrays.submaps[:], arrays.nodes[:] = submaps, nodes
            start = time.perf_counter()
            iterations = call()
            if k:
                times[name].append(1e3 * (time.perf_counter() - start))
    count = len(arrays.constraints.node)
    print(f"{graph.num_nodes} nodes, {graph.num_submaps} submaps, {count} constraints ({options.loops} loops)")
    for name, values in times.items():
        print(f"{name:15s} {min(values):6.2f} ms, median {np.median(values):6.2f} ms")
    errors = [np.sqrt(np.mean(np.sum((each - truth)[:, :2] ** 2, axis=1))) for each in (nodes, arrays.nodes)]
    print(f"{iterations} iterations; error of nodes {errors[0]:.3f} m before, {errors[1]:.3f} m after (RMSE)")


if __name__ == "__main__":
    main(tyro.cli(Options))

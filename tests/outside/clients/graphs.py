"""Pose graphs and trajectories: `graphs.py FUNCTION ARGUMENTS...`; prints JSON."""

import contextlib
import io
import json
import sys
from pathlib import Path

import g2opy
import gtsam
import numpy as np
from evo.core import metrics, sync
from evo.core.trajectory import PoseTrajectory3D
from evo.core.units import Unit
from evo.tools import file_interface
from graphslam.graph import Graph


def optimise(library, path):
    """Return the numbers of vertices and edges of a g2o file, chi2 before and after, and the poses after."""
    if library == "gtsam":
        graph, initial = gtsam.readG2o(path)
        sizes, before = [initial.size(), graph.size()], 2 * graph.error(initial)
        held = gtsam.NonlinearFactorGraph(graph)
        held.add(gtsam.PriorFactorPose2(0, initial.atPose2(0), gtsam.noiseModel.Constrained.All(3)))
        settings = gtsam.LevenbergMarquardtParams()
        settings.setRelativeErrorTol(1e-14)
        settings.setAbsoluteErrorTol(1e-14)
        found = gtsam.LevenbergMarquardtOptimizer(held, initial, settings).optimize()
        after = 2 * graph.error(found)
        poses = [[found.atPose2(k).x(), found.atPose2(k).y()] for k in range(found.size())]
    elif library == "g2opy":
        optimizer = g2opy.SparseOptimizer()
        solver = g2opy.BlockSolverSE2(g2opy.LinearSolverEigenSE2())
        optimizer.set_algorithm(g2opy.OptimizationAlgorithmLevenberg(solver))
        assert optimizer.load(path)
        vertices = optimizer.vertices()
        sizes = [len(vertices), len(optimizer.edges())]
        assert optimizer.initialize_optimization()
        optimizer.compute_active_errors()
        before = optimizer.chi2()
        optimizer.optimize(50)
        after = optimizer.chi2()
        poses = [list(map(float, vertices[k].estimate().to_vector()[:2])) for k in sorted(vertices)]
    else:
        graph = Graph.from_g2o(path)
        sizes, before = [len(graph._vertices), len(graph._edges)], float(graph.calc_chi2())
        graph.optimize(tol=1e-12, max_iter=50, fix_first_pose=True, verbose=False)
        after = float(graph.calc_chi2())
        poses = [vertex.pose.to_array()[:2].tolist() for vertex in graph._vertices]
    return {"sizes": sizes, "before": before, "after": after, "poses": poses}


def errors(estimate, truth):
    """Return the faults that evo finds in a TUM file, and its absolute and relative errors."""
    estimate, truth = map(file_interface.read_tum_trajectory_file, (estimate, truth))
    is_valid, details = estimate.check()
    found = {"valid": is_valid, "details": str(details), "poses": estimate.num_poses}
    for name, metric in {
        "ape": metrics.APE(metrics.PoseRelation.translation_part),
        "rpe": metrics.RPE(metrics.PoseRelation.translation_part, 1, Unit.frames),
        "rpe_angle": metrics.RPE(metrics.PoseRelation.rotation_angle_deg, 1, Unit.frames),
    }.items():
        metric.process_data(sync.associate_trajectories(truth, estimate))
        found[name] = {key: float(value) for key, value in metric.get_all_statistics().items()}
    return found


def write(folder):
    """Write a pose graph and a trajectory by each library; return the paths."""
    folder = Path(folder)
    folder.mkdir(parents=True)
    found = {name: str(folder / file) for name, file in {
        "pose graph of GTSAM": "gtsam.g2o", "pose graph of g2o": "g2o.g2o", "pose graph of graphslam": "graphslam.g2o",
        "trajectory of evo (TUM)": "evo.txt", "trajectory of evo (KITTI)": "kitti.txt",
    }.items()}  # fmt: skip
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    noise = gtsam.noiseModel.Diagonal.Sigmas([0.1, 0.1, 0.05])
    for k in range(4):
        values.insert(k, gtsam.Pose2(k, 0.1 * k, 0.2 * k))
        if k:
            graph.add(gtsam.BetweenFactorPose2(k - 1, k, gtsam.Pose2(1.0, 0.1, 0.2), noise))
    gtsam.writeG2o(graph, values, found["pose graph of GTSAM"])
    optimizer = g2opy.SparseOptimizer()
    assert optimizer.load(found["pose graph of GTSAM"])
    optimizer.save(found["pose graph of g2o"])
    Graph.from_g2o(found["pose graph of GTSAM"]).to_g2o(found["pose graph of graphslam"])
    angles = 0.2 * np.arange(5)
    turns = np.stack([np.cos(angles / 2), 0 * angles, 0 * angles, np.sin(angles / 2)], axis=1)
    path = PoseTrajectory3D(np.stack([np.arange(5.0), 0 * angles, 0 * angles], axis=1), turns, 100.0 + np.arange(5.0))
    file_interface.write_tum_trajectory_file(found["trajectory of evo (TUM)"], path)
    file_interface.write_kitti_poses_file(found["trajectory of evo (KITTI)"], path)
    return found


if __name__ == "__main__":
    with contextlib.redirect_stdout(io.StringIO()):  # some libraries print
        answer = globals()[sys.argv[1]](*sys.argv[2:])
    print(json.dumps(answer))

"""Pose graphs and trajectories by GTSAM, g2o, graphslam and evo."""

import g2opy
import gtsam
from evo.core import metrics, sync
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
        found = gtsam.LevenbergMarquardtOptimizer(held, initial).optimize()
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


def write(graph, trajectory, folder):
    """Read a pose graph and a trajectory, and write them by each library; return the paths."""
    found = {f"pose graph of {library}": f"{folder}/{library}.g2o" for library in ("GTSAM", "g2o", "graphslam")}
    found |= {f"trajectory of evo ({form})": f"{folder}/{form}.txt" for form in ("TUM", "KITTI")}
    by_gtsam, by_g2o, by_graphslam, tum, kitti = found.values()
    gtsam.writeG2o(*gtsam.readG2o(graph), by_gtsam)
    optimizer = g2opy.SparseOptimizer()
    assert optimizer.load(graph)
    optimizer.save(by_g2o)
    Graph.from_g2o(graph).to_g2o(by_graphslam)
    path = file_interface.read_tum_trajectory_file(trajectory)
    file_interface.write_tum_trajectory_file(tum, path)
    file_interface.write_kitti_poses_file(kitti, path)
    return found

import numpy as np
import pytest
from scipy.optimize import least_squares

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.slam.posegraph import PoseGraph, chi_squares, drop_outliers, optimise_step

PHI = 9.0


def optimise(graph, phi, max_iterations, tolerance):
    """Optimise a pose graph until pose changes are below `tolerance`; return the number of iterations."""
    return next((k + 1 for k in range(max_iterations) if optimise_step(graph, phi) < tolerance), max_iterations)


def random_graph(seed, num_outliers=0):
    """Return a graph of 3 submaps and 9 nodes with anisotropic, correlated constraints."""
    rng = np.random.default_rng(seed)
    graph, submaps = PoseGraph(), [Pose2D(0.3, -0.2, 2.0), Pose2D(2.0, 1.0, -3.0), Pose2D(4.0, 0.5, 1.0)]
    truth = [Pose2D(*rng.uniform([0, -2, -3], [5, 2, 3])) for _ in range(9)]
    for k, pose in enumerate(submaps):
        graph.add_submap(np.array(pose) + (0.1 * rng.standard_normal(3) if k else 0.0))
    for pose in truth:
        graph.add_node(np.array(pose) + 0.1 * rng.standard_normal(3))
    pairs = [(j, k, False) for j in range(9) for k in {min(j // 3, 2), min(j // 3 + 1, 2)}]
    pairs += [(7, 0, True), (8, 0, True), (2, 2, True), (2, 2, True)]
    for j, k, is_loop in pairs:
        root = 0.03 * rng.standard_normal((3, 3)) + 0.03 * np.eye(3)
        covariance = root @ root.T + 1e-5 * np.eye(3)
        noise = np.linalg.cholesky(covariance) @ rng.standard_normal(3)
        graph.add_constraint(j, k, np.array(submaps[k].between(truth[j])) + noise, covariance, is_loop)
    for _ in range(num_outliers):
        graph.add_constraint(8, 0, [3.0, -2.0, 1.0], 1e-3 * np.eye(3), is_loop=True)
    return graph


def reference(graph, phi):
    submaps, nodes, constraints = graph.arrays
    num_submaps = len(submaps)

    def residuals(x):
        poses = np.concatenate([submaps[:1].ravel(), x]).reshape(-1, 3)
        parts = []
        for j, k, relative, information, is_loop, _ in zip(*constraints):
            found = Pose2D(*poses[k]).between(Pose2D(*poses[num_submaps + j]))
            e = np.array(found) - relative
            e[2] = (e[2] + np.pi) % (2 * np.pi) - np.pi
            white = np.linalg.cholesky(information).T @ e
            chi2 = white @ white
            if is_loop and chi2 > phi:  # the integral of the weight over chi^2
                white *= np.sqrt((3 * phi - 4 * phi**2 / (phi + chi2)) / chi2)
            parts.append(white)
        return np.concatenate(parts)

    start = np.concatenate([submaps[1:].ravel(), nodes.ravel()])
    found = least_squares(residuals, start, xtol=1e-14, ftol=1e-14, gtol=1e-14).x.reshape(-1, 3)
    return found[: num_submaps - 1], found[num_submaps - 1 :]


@pytest.mark.parametrize(("seed", "phi", "num_outliers"), [(0, np.inf, 0), (1, np.inf, 1), (2, PHI, 0), (3, PHI, 2)])
def test_optimum_equals_that_of_scipy(seed, phi, num_outliers):
    graph = random_graph(seed, num_outliers)
    expected_submaps, expected_nodes = reference(graph, phi)
    first = graph.arrays.submaps[0].copy()
    assert optimise(graph.arrays, phi, 60, 1e-11) < 60
    np.testing.assert_array_equal(graph.arrays.submaps[0], first)
    for found, expected in ((graph.arrays.submaps[1:], expected_submaps), (graph.arrays.nodes, expected_nodes)):
        difference = found - expected
        difference[:, 2] = (difference[:, 2] + np.pi) % (2 * np.pi) - np.pi
        np.testing.assert_allclose(difference, 0.0, atol=2e-6)


def test_outliers_among_loops_are_dropped():
    graph, clean = random_graph(3, 2), random_graph(3, 0)
    for each in (graph, clean):
        optimise(each.arrays, PHI, 60, 1e-11)
    drop_outliers(graph.arrays, 54.0)
    is_outlier = np.arange(21) >= 19  # the last two constraints
    np.testing.assert_array_equal(graph.arrays.constraints.is_active, ~is_outlier)
    assert (chi_squares(graph.arrays)[~is_outlier] < 54.0).all()
    optimise(graph.arrays, PHI, 60, 1e-11)
    np.testing.assert_allclose(graph.arrays.nodes, clean.arrays.nodes, atol=1e-9)


def test_a_loop_in_a_corridor_corrects_across_it_and_not_along_it():
    # The submap's x axis points along y of the map; a corridor along that axis leaves its x uncertain.
    graph = PoseGraph()
    graph.add_submap([0.0, 0.0, np.pi / 2])
    graph.add_submap([0.0, 5.0, np.pi / 2])
    graph.add_node([0.0, 6.0, np.pi / 2])
    graph.add_constraint(0, 1, [1.0, 0.0, 0.0], np.diag([1e-4, 1e-4, 1e-4]))
    graph.add_node([0.0, 4.0, np.pi / 2])
    graph.add_constraint(1, 0, [4.0, 0.0, 0.0], np.diag([0.01, 0.01, 0.01]))
    graph.add_constraint(1, 1, [-1.0, 0.0, 0.0], np.diag([0.01, 0.01, 0.01]))
    graph.add_constraint(0, 0, [6.5, -0.2, 0.0], np.diag([4.0, 1e-4, 1e-3]), is_loop=True)
    optimise(graph.arrays, np.inf, 20, 1e-9)
    x, y, _ = graph.arrays.nodes[0]
    assert 0.17 < x < 0.2  # y of the submap is -x of the map
    assert abs(y - 6.0) < 0.02


def test_what_nothing_determines_stays():
    graph = PoseGraph()
    assert optimise(graph.arrays, PHI, 5, 1e-4) == 1
    for pose in ([0.0, 0.0, 0.0], [3.0, 1.0, 0.5], [7.0, 0.0, 0.0]):
        graph.add_submap(pose)
    graph.add_node([1.0, 0.0, 0.0])
    graph.add_node([2.0, 0.0, 0.1])
    graph.add_constraint(1, 0, [2.0, 0.0, 0.0], 0.01 * np.eye(3))
    graph.add_constraint(1, 1, [-1.0, -0.5, 0.0], 0.01 * np.eye(3))
    assert optimise(graph.arrays, PHI, 10, 0.0) == 10
    np.testing.assert_array_equal(graph.arrays.nodes[0], [1.0, 0.0, 0.0])
    np.testing.assert_array_equal(graph.arrays.submaps[2], [7.0, 0.0, 0.0])
    np.testing.assert_allclose(graph.arrays.nodes[1], [2.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(graph.arrays.submaps[1], [3.0, 0.5, 0.0], atol=1e-9)


def test_a_graph_grows():
    graph = PoseGraph()
    graph.add_submap([0.0, 0.0, 0.0])
    graph.add_node([0.0, 0.0, 0.0])
    graph.add_constraint(0, 0, [0.0, 0.0, 0.0], np.eye(3))
    assert graph.arrays.constraints.node.tolist() == [0]
    assert [graph.add_node([float(k), 0.0, 0.0]) for k in range(99)] == list(range(1, 100))
    np.testing.assert_array_equal(graph.arrays.nodes[:, 0], [0, *range(99)])

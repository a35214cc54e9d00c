import numpy as np

from envs.slam.posegraph import PoseGraph
from envs.slam.posegraph.distances import least_distances, path_lengths


def test_loops_shorten_the_path_through_the_graph():
    graph = PoseGraph()
    for _ in range(8):
        graph.add_submap([0.0, 0.0, 0.0])
        graph.add_node([0.0, 0.0, 0.0])
    home, travelled = np.arange(8, dtype=np.int32), np.array([0.0, 3.0, 5.0, 9.0, 14.0, 15.0, 20.0, 26.0])
    graph.add_constraint(3, 2, [0.0, 0.0, 0.0], np.eye(3))
    np.testing.assert_array_equal(path_lengths(graph.arrays.constraints, home, travelled, 6), np.abs(travelled - 20.0))

    graph.add_constraint(5, 1, [0.0, 0.0, 0.0], np.eye(3), is_loop=True)  # 15 m = 3 m
    graph.add_constraint(7, 3, [0.0, 0.0, 0.0], np.eye(3), is_loop=True)  # 26 m = 9 m
    lengths = path_lengths(graph.arrays.constraints, home, travelled, 6)
    # 0: 6-5-1-0; 1: 6-5-1; 2: 6-5-1-2; 3: 6-7-3; 4: 6-5-4; 5; 6; 7
    np.testing.assert_array_equal(lengths, [8.0, 5.0, 7.0, 6.0, 6.0, 5.0, 0.0, 6.0])

    graph.arrays.constraints.is_active[1:] = False
    np.testing.assert_array_equal(path_lengths(graph.arrays.constraints, home, travelled, 6), np.abs(travelled - 20.0))


def test_the_nearest_node_of_a_submap_counts():
    nodes = np.array([[0.0, 0.0, 0.0], [3.0, 4.0, 0.0], [6.0, 8.0, 0.0], [1.0, 0.0, 0.0]])
    spans = np.array([[0, 2], [1, 3], [3, 3]])
    assert least_distances(nodes, spans, 3).tolist() == [1.0, np.hypot(2.0, 4.0), np.inf]

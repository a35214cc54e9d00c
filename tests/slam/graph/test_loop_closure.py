import numpy as np
import pytest

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.robots import LidarParams
from lidarnaut.envs.slam.graph.loop_search import Confirmation, Loop, least_distances, path_lengths, window_size
from lidarnaut.envs.slam.graph.nodes import NodeStore
from lidarnaut.envs.slam.posegraph import PoseGraph


def test_windows_grow_with_the_path_up_to_a_limit():
    assert window_size(0.0, 4.0) == (0.5, 0.1)
    assert window_size(10.0, 4.0) == pytest.approx((1.1, 0.25))
    assert window_size(1e3, 4.0) == (4.0, 0.6)


def loop(node, before, shift):
    """Return a loop closure that moves a node by a correction of the whole map."""
    before = Pose2D(*before)
    return Loop(node, 0, Pose2D(0, 0, 0), np.eye(3), before, Pose2D(*shift).compose(before))


def test_small_corrections_are_taken_at_once_and_large_ones_wait_for_a_second_one_that_agrees():
    small = loop(100, (3.0, 1.0, 0.0), (0.2, 0.0, 0.0))
    assert Confirmation().add(small) == [small]
    shift = (0.8, -0.3, 0.1)
    first = loop(100, (3.0, 1.0, 0.5), shift)
    same_node = loop(100, (3.0, 1.0, 0.5), shift)
    other = loop(104, (3.5, 1.5, 1.0), (0.1, 0.9, 0.1))
    second = loop(110, (4.0, 2.5, 2.0), shift)
    confirmation = Confirmation()
    assert [confirmation.add(each) for each in (first, same_node, other)] == [[], [], []]
    assert confirmation.add(second) == [first, second]
    # Closures disagree if they differ in heading, or after too many nodes.
    confirmation = Confirmation()
    assert confirmation.add(first) == []
    turned = second._replace(after=second.after._replace(theta=second.after.theta + 0.06))
    assert confirmation.add(turned) == []
    assert confirmation.add(loop(126, (4.0, 2.5, 2.0), shift)) == []


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
    spans = np.array([[0, 2], [1, 3], [2, 4]])
    assert least_distances(nodes, spans, 3).tolist() == [1.0, np.hypot(2.0, 4.0), 0.0]


LIDAR = LidarParams(num_beams=4, range_max=40.0)
"""Beams to the back, the right, the front and the left."""


def store_of(poses, scans):
    store = NodeStore(LIDAR)
    for k, (pose, ranges) in enumerate(zip(poses, scans)):
        if k % 2 == 0:
            store.add_submap(float(k))
        submaps = [each for each in (k // 2 - 1, k // 2) if each >= 0]
        store.add_node(np.array(ranges, dtype=np.float32), Pose2D(*pose), submaps)
    return store


def test_submaps_hold_nodes_that_follow_one_another():
    poses = [(0.1 * k, 1.0, 0.2 * k) for k in range(7)]
    store = store_of(poses, [(np.inf, np.nan, 1.0 + k, np.inf) for k in range(7)])
    assert store.spans.rows.tolist() == [[0, 4], [2, 6], [4, 7], [6, 7]]
    assert store.home.rows.tolist() == [0, 0, 1, 1, 2, 2, 3]
    assert store.travelled.rows.tolist() == [0.0, 2.0, 4.0, 6.0]
    assert store.submap_pose(2) == (0.4, 1.0, 0.0)
    np.testing.assert_allclose(store.recent_points(3, 1, np.inf, 9), [[4.0, 0.0]], atol=1e-6)
    ranges, in_submap = store.submap_scans(2)
    assert ranges[:, 2].tolist() == [5.0, 6.0, 7.0]
    np.testing.assert_allclose(in_submap, [(0.1 * k, 0.0, 0.8 + 0.2 * k) for k in range(3)])


def test_points_of_recent_nodes_are_joined_one_per_cell():
    # The first two nodes see the objects to the right of the last node, and the second also a distant point ahead.
    poses = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 0.0, np.pi / 2)]
    scans = [(np.nan, np.nan, 2.03, np.nan), (np.nan, np.nan, 1.04, 30.0), (np.nan, 1.03, 0.5, np.nan)]
    store = store_of(poses, scans)
    one = store.recent_points(2, 1, 12.0, 100)
    np.testing.assert_allclose(one, [[0.0, -1.03], [0.5, 0.0]], atol=1e-6)
    assert len(store.recent_points(2, 3, 12.0, 100)) == 2
    assert len(store.recent_points(2, 3, 40.0, 100)) == 3
    assert len(store.recent_points(2, 3, 40.0, 2)) == 2
    store.first_joined = len(store)
    node = store.add_node(np.array([np.nan, 1.0, 1.0, 1.0], dtype=np.float32), Pose2D(1.0, 0.0, 0.0), [1])
    assert len(store.recent_points(node, 4, 40.0, 100)) == 3

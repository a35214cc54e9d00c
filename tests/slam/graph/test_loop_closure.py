import numpy as np
import pytest

from envs.geometry import Pose2D
from envs.slam.graph.loop_search import Confirmation, Loop, least_distances, path_lengths, search_window
from envs.slam.posegraph import PoseGraph


def test_windows_grow_with_the_path_up_to_a_limit():
    assert search_window(0.0) == (0.5, 0.1)
    assert search_window(10.0) == pytest.approx((1.1, 0.25))
    assert search_window(1e3) == (4.0, 0.6)


def loop(node, before, shift):
    """Return a loop closure that moves a node by a correction of the map as a whole."""
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
    # Turned otherwise it does not agree, and neither does it after too many nodes.
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

import numpy as np

from envs.geometry import Pose2D
from envs.robots import LidarParams
from envs.slam.graph.nodes import NodeStore

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
    assert store.spans.tolist() == [[0, 4], [2, 6], [4, 7], [6, 7]]
    assert store.home.tolist() == [0, 0, 1, 1, 2, 2, 3]
    assert store.travelled.tolist() == [0.0, 2.0, 4.0, 6.0]
    assert store.submap_pose(2) == (0.4, 1.0, 0.0)
    np.testing.assert_allclose(store.points(3), [[4.0, 0.0]], atol=1e-6)
    ranges, in_submap = store.submap_scans(2)
    assert ranges[:, 2].tolist() == [5.0, 6.0, 7.0]
    np.testing.assert_allclose(in_submap, [(0.1 * k, 0.0, 0.8 + 0.2 * k) for k in range(3)])


def test_points_of_recent_nodes_are_joined_one_per_cell():
    # The first two nodes see what the last one sees at its right, and the second one something far ahead.
    poses = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 0.0, np.pi / 2)]
    scans = [(np.nan, np.nan, 2.03, np.nan), (np.nan, np.nan, 1.04, 30.0), (np.nan, 1.03, 0.5, np.nan)]
    store = store_of(poses, scans)
    one = store.recent_points(2, 1, 12.0, 100)
    np.testing.assert_allclose(one, [[0.0, -1.03], [0.5, 0.0]], atol=1e-6)
    assert len(store.recent_points(2, 3, 12.0, 100)) == 2
    assert len(store.recent_points(2, 3, 40.0, 100)) == 3
    assert len(store.recent_points(2, 3, 40.0, 2)) == 2
    store.break_off()
    node = store.add_node(np.array([np.nan, 1.0, 1.0, 1.0], dtype=np.float32), Pose2D(1.0, 0.0, 0.0), [1])
    assert len(store.recent_points(node, 4, 40.0, 100)) == 3

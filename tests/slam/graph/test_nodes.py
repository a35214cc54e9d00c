import numpy as np

from envs.geometry import Pose2D
from envs.robots import LidarParams
from envs.slam.graph.nodes import NodeStore


def store_of(poses, points):
    store = NodeStore(LidarParams(num_beams=4, range_max=40.0))
    for k, (pose, some) in enumerate(zip(poses, points)):
        if k % 2 == 0:
            store.add_submap(float(k))
        submaps = [each for each in (k // 2 - 1, k // 2) if each >= 0]
        store.add_node(
            np.full(4, float(k), dtype=np.float32),
            np.array(some, dtype=np.float32).reshape(-1, 2),
            Pose2D(*pose),
            submaps,
        )
    return store


def test_submaps_hold_nodes_that_follow_one_another():
    poses = [(0.1 * k, 1.0, 0.2 * k) for k in range(7)]
    store = store_of(poses, [[(1.0, k)] for k in range(7)])
    assert [store.nodes_of(k) for k in range(4)] == [slice(0, 4), slice(2, 6), slice(4, 7), slice(6, 7)]
    assert store.home.tolist() == [0, 0, 1, 1, 2, 2, 3]
    assert store.travelled.tolist() == [0.0, 2.0, 4.0, 6.0]
    assert store.submap_pose(2) == (0.4, 1.0, 0.0)
    assert store.points(3).tolist() == [[1.0, 3.0]]
    assert store.ranges.tolist() == [[float(k)] * 4 for k in range(7)]


def test_a_field_is_rendered_in_the_frame_of_its_submap():
    # Both nodes of submap 0 see the same wall at (2.02, 1.02) in the local frame.
    store = store_of([(1.0, 1.0, 0.0), (2.02, 0.0, np.pi / 2)], [[(1.02, 0.02)], [(1.02, 0.0)]])
    field, geometry = store.render(0, 0.1)
    row, col = round((0.05 - geometry.y) / 0.1 - 0.5), round((1.05 - geometry.x) / 0.1 - 0.5)
    assert np.argwhere(field > 50).tolist() == [[row, col]]
    assert field[row, col] > 98  # two hits


def test_points_of_recent_nodes_are_joined_one_per_cell():
    store = store_of(
        [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 0.0, np.pi / 2)],
        [[(2.03, 0.04)], [(1.04, 0.02), (30.0, 0.0)], [(0.02, -1.03), (0.5, 0.5)]],
    )
    one = store.recent_points(2, 1, 0.1, 12.0)
    np.testing.assert_allclose(one, [[0.02, -1.03], [0.5, 0.5]], atol=1e-6)
    # The first two nodes see what the last one sees, and something out of range.
    np.testing.assert_allclose(store.recent_points(2, 3, 0.1, 12.0), one, atol=1e-6)
    assert len(store.recent_points(2, 3, 0.1, 40.0)) == 3

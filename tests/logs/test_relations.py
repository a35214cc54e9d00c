import io
import math
from dataclasses import replace

import numpy as np
import pytest

from lidarnaut.envs.logs import follow_odometry, load_log, load_relations, relation_error, trajectory_errors
from lidarnaut.envs.logs.log import Log
from lidarnaut.envs.logs.relations import load_labelled
from lidarnaut.envs.logs.runs import conflict_share
from lidarnaut.envs.robots import LidarParams, Mount
from tests.data import INTEL, needs_intel


def test_relation_error_by_hand(tmp_path):
    # Straight along y at 1 m/s, heading y; the third second was driven 0.3 m too far and turned by 2 degrees.
    times = np.array([5.0, 6.0, 8.0, 7.0])  # the clock jumps
    poses = np.array([[0, 0, np.pi / 2], [0, 1, np.pi / 2], [0, 3.3, np.pi / 2 + math.radians(2)], [0, 2, np.pi / 2]])
    file = tmp_path / "relations"
    file.write_text("5.1 5.9 1 0 0 0 0 0\n7 8 1 0 0 0 0 0\n5 9 4 0 0 0 0 0\n")
    error = relation_error(times, poses, load_relations(file))
    assert error.count == 2  # nothing within 0.3 s of second 9
    assert (error.translation, error.translation_std) == pytest.approx((0.15, 0.15))
    assert (error.rotation, error.rotation_std) == pytest.approx((1.0, 1.0))
    with pytest.raises(ValueError, match="another log"):
        relation_error(times + 100, poses, load_relations(file))


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (b"# nothing\n", "holds no relations"),
        (b"1 2 3\n", "8 numbers per line"),
        (b"1 2 0 0 0 0 0 0\n1 2\n", "not a list of relations"),
        (b"one two\n", "not a list of relations"),
        (bytes(range(256)), "not a list of relations"),
        (b"1 2 0 0 0 0 0 0\n1 2 nan 0 0 0 0 0\n", "relation 1 is not finite"),
        (b"1 0 0 0 0 0 0 1\n2 1 0 0 0 0 0.6 0.8\n3 2 0 0 0 0 1 0\n", "a trajectory in TUM format"),
    ],
)
def test_bad_relations_are_named(tmp_path, content, complaint):
    file = tmp_path / "relations"
    file.write_bytes(content)
    with pytest.raises(ValueError, match=complaint) as caught:
        load_relations(file)
    assert str(caught.value).startswith(str(file))


def test_a_mask_has_a_truth_value_per_relation(tmp_path):
    relations, file = tmp_path / "relations", tmp_path / "unambiguous_relations.npy"
    relations.write_text("1 2 1 0 0 0 0 0\n3 4 1 0 0 0 0 0\n")
    assert load_labelled(relations).keys() == {"relation error"}
    np.save(file, np.array([True, False]))
    np.testing.assert_array_equal(load_labelled(relations)["unambiguous"][:, 0], [1.0])
    for mask in (np.ones(3, dtype=bool), np.ones((1, 2), dtype=bool), np.array([0, 1]), np.zeros(2, dtype=bool)):
        np.save(file, mask)
        with pytest.raises(ValueError, match=r"relations.npy: must be a mask of 2 relations"):
            load_labelled(relations)
    archive = io.BytesIO()
    np.savez(archive, mask=np.ones(2, dtype=bool))
    lie = file.read_bytes().replace(b"(2,), }" + b" " * 15, b"(" + b"9" * 15 + b",), }")
    for damaged in (b"", b"text", file.read_bytes()[:-1], archive.getvalue(), lie):
        file.write_bytes(damaged)
        with pytest.raises(ValueError, match=r"relations.npy: damaged"):
            load_labelled(relations)


def test_between_scans_the_trajectory_follows_odometry():
    odometry = np.array([[0, 0, 0], [1, 0, 0], [2, 0, np.pi / 2], [2, 1, np.pi / 2], [2, 2, np.pi / 2]], dtype=float)
    scan_poses = np.array([[10, 0, np.pi / 2], [20, 0, 0]], dtype=float)
    expected = [[10, -1, np.pi / 2], [10, 0, np.pi / 2], [10, 1, np.pi], [20, 0, 0], [21, 0, 0]]
    result = follow_odometry(odometry, np.array([1, 3]), scan_poses)
    np.testing.assert_allclose(result[:, :2], np.array(expected)[:, :2], atol=1e-12)
    np.testing.assert_allclose(np.cos(result[:, 2]), np.cos(np.array(expected)[:, 2]), atol=1e-12)


def test_trajectory_errors_wrap_headings():
    distance, angle = trajectory_errors(np.array([[3.0, 4.0, 3.1]]), np.array([[0.0, 0.0, -3.1]]))
    assert (distance[0], angle[0]) == pytest.approx((5.0, 2 * math.pi - 6.2))


@needs_intel
def test_intel_raw_odometry_has_its_known_error():
    log, relations = load_log(INTEL / "scans_2725.npz"), load_relations(INTEL / "intel.relations")
    error = relation_error(log.times, log.odometry, relations)
    assert error.count == 2984
    assert error.translation == pytest.approx(7.38, abs=0.01)
    unambiguous = relation_error(log.times, log.odometry, relations[np.load(INTEL / "unambiguous_relations.npy")])
    assert unambiguous.translation == pytest.approx(6.66, abs=0.01)


LIDAR = LidarParams(num_beams=4, range_max=8.0, fov=1.5 * math.pi, mount=Mount(0.12, 0.0, yaw=0.75 * math.pi))
"""Beams ahead, to the left, back and to the right, from 0.12 m ahead of the base."""


def log_of(ranges):
    num_scans = len(ranges)
    scans = np.array(ranges, dtype=np.float32)
    return Log(np.arange(num_scans) * 1.0, np.zeros((num_scans, 3)), np.arange(num_scans), scans, LIDAR)


def test_beams_through_walls_are_counted():
    log = log_of([[2.0, 2.0, 2.0, 2.0]] * 10 + [[4.0, 4.0, 2.2, np.inf]])
    still = np.zeros((11, 3))
    assert conflict_share(log, still) == 2 / 43
    turned = still.copy()
    turned[:10, 2] = math.pi / 4  # beams miss the wall that the last scan passes through
    assert conflict_share(log, turned) == 0.0
    # A room seen twice at different poses.
    log = log_of([[2.0, 2.0, 2.0, 2.0]] * 10)
    poses = np.zeros((10, 3))
    assert conflict_share(log, poses) == 0.0
    poses[5:, 0] = 1.0
    assert conflict_share(log, poses) == 0.25  # ahead from the second half, back from the first
    for value in (np.nan, 1e12):
        poses[3, 1] = value
        assert math.isnan(conflict_share(log, poses))
    assert math.isnan(conflict_share(log_of([[np.inf] * 4, [np.nan] * 4]), np.zeros((2, 3))))


def test_thinned_logs_keep_scans_that_are_far_apart_or_turned():
    x = np.array([0.0, 0.3, 0.6, 1.1, 1.2, 1.2, 1.2])
    theta = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.3, 0.7])
    log = replace(log_of([[1.0 + k] * 4 for k in range(7)]), odometry=np.stack([x, 0 * x, theta], axis=1))
    thinned = log.thinned(1.0, 0.5)
    np.testing.assert_array_equal(thinned.scan_rows, [0, 3, 6])
    np.testing.assert_array_equal(thinned.ranges[:, 0], [1.0, 4.0, 7.0])
    assert len(thinned.times) == 7
    assert log.step_length == pytest.approx(0.3)
    assert thinned.step_length == pytest.approx(0.6)

import math

import numpy as np
import pytest

from lidarnaut.envs.logs import load_log
from tests.logs.bags import drive, write_bag

INF, NAN = math.inf, math.nan


def standing(tmp_path, ranges, *mount, **beams):
    """Write a bag of two scans of a robot that stands still, with the mount (x, y, yaw, roll) of its lidar."""

    def messages(m):
        if mount:
            yield "/tf_static", m.transforms(0.0, ("base_link", "laser", *mount))
        for k in range(2):
            yield "/odom", m.odometry(float(k), 0.0, 0.0, 0.0)
            yield "/scan", m.scan(float(k), ranges, **beams)

    return write_bag(tmp_path / "drive", messages)


@pytest.mark.parametrize("storage", ["ros1", "sqlite3", "mcap", "file"])
def test_bags_of_all_kinds(tmp_path, storage):
    log = load_log(write_bag(tmp_path / "drive", drive, storage))
    np.testing.assert_allclose(log.times, 10.0 + 0.05 * np.arange(7), atol=1e-9)
    np.testing.assert_allclose(log.odometry[:, 0], 0.25 * np.arange(7), atol=1e-7)
    np.testing.assert_array_equal(log.scan_rows, [1, 3, 5])
    np.testing.assert_array_equal(log.ranges, [[1.0, NAN, NAN, 8.0, INF]] * 3)
    assert (log.lidar.range_min, log.lidar.range_max) == pytest.approx((0.1, 8.0))
    assert (log.lidar.mount.x, log.lidar.mount.y, log.lidar.mount.z) == pytest.approx((0.1, 0.2, 0.4))
    angles = log.lidar.angles + log.lidar.mount.yaw
    np.testing.assert_allclose(angles, math.pi / 2 + np.array([-1.0, -0.5, 0.0, 0.5, 1.0]), atol=1e-6)


@pytest.mark.parametrize(
    ("storage", "compression"),
    [("ros1", "BZ2"), ("ros1", "LZ4"), ("mcap", "STORAGE"), ("mcap", "MESSAGE"), ("sqlite3", "MESSAGE")],
)
def test_what_is_compressed_unpacks_to_a_limited_size(tmp_path, monkeypatch, storage, compression):
    path = write_bag(tmp_path / "drive", drive, storage, compression)
    np.testing.assert_array_equal(load_log(path).ranges, [[1.0, NAN, NAN, 8.0, INF]] * 3)
    monkeypatch.setattr("lidarnaut.envs.logs.bag_reader.MAX_CHUNK", 100)
    with pytest.raises(ValueError, match=r"drive(\.bag)?: .*unpacks to more than the 100 bytes that are allowed"):
        load_log(path)


def test_scans_of_a_bag_have_the_limit_of_arrays(tmp_path, monkeypatch):
    path = write_bag(tmp_path / "drive", drive)
    monkeypatch.setattr("lidarnaut.envs.logs.bag.MAX_BYTES", 59)
    with pytest.raises(ValueError, match=r"drive: /scan: unpacks to 60 bytes; at most 59 are allowed"):
        load_log(path)
    monkeypatch.setattr("lidarnaut.envs.logs.bag.MAX_BYTES", 60)
    assert len(load_log(path).ranges) == 3


def test_transforms_serve_as_odometry(tmp_path):
    def messages(m):
        for k in range(3):
            moved = ("/odom", "/base_footprint", float(k), 0.0, 3.0 + 0.2 * k, 0.0)
            for edge in (("map", "odom", 9.0, 9.0, 0.0, 0.0), moved, ("base_footprint", "laser", 0.3, 0.0, 0.0, 0.0)):
                yield "/tf", m.transforms(5.0 + k, edge)
            yield "/scan", m.scan(5.0 + k, [1.0, 2.0])

    log = load_log(write_bag(tmp_path / "drive", messages, "ros1"))
    np.testing.assert_allclose(log.odometry, [[0, 0, 3.0], [1, 0, 3.2 - 2 * math.pi], [2, 0, 3.4 - 2 * math.pi]])
    np.testing.assert_array_equal(log.scan_rows, [0, 1, 2])
    assert log.lidar.mount.x == pytest.approx(0.3)


@pytest.mark.parametrize(("roll", "step"), [(math.pi, 0.5), (0.0, -0.5), (math.pi, -0.5)])
def test_beams_that_turn_clockwise(tmp_path, roll, step):
    log = load_log(standing(tmp_path, [1.0, 2.0, 3.0], 0.0, 0.0, 0.4, roll, angle_min=0.1, step=step))
    sign = -1.0 if roll else 1.0
    expected = {round(0.4 + sign * (0.1 + step * k), 5): 1.0 + k for k in range(3)}
    angles = np.round(log.lidar.angles + log.lidar.mount.yaw, 5)
    assert dict(zip(angles.tolist(), log.ranges[0].tolist())) == pytest.approx(expected)


def test_the_beam_that_ends_a_full_turn_is_left_out(tmp_path):
    log = load_log(standing(tmp_path, [1.0, 2.0, 3.0, 4.0, 1.0], angle_min=0.0, step=math.pi / 2))
    np.testing.assert_array_equal(log.ranges[0], [1.0, 2.0, 3.0, 4.0])
    np.testing.assert_allclose(log.lidar.angles + log.lidar.mount.yaw, np.arange(4) * math.pi / 2, atol=1e-6)


def test_topics_are_chosen_or_listed(tmp_path, caplog):
    def messages(m):
        for k in range(2):
            yield "/front", m.scan(float(k), [1.0, 2.0])
            yield "/rear", m.scan(float(k), [3.0, 4.0])
            yield "/odom", m.odometry(float(k), 1.0 * k, 0.0, 0.0)
            yield "/fused", m.odometry(float(k), 2.0 * k, 0.0, 0.0)

    path = write_bag(tmp_path / "drive", messages, "file")
    with pytest.raises(ValueError, match=r"drive.mcap: 2 topics hold .*LaserScan: /front, /rear; .*scan_topic"):
        load_log(path)
    with pytest.raises(ValueError, match=r"2 topics hold .*Odometry: /fused, /odom; .*odom_topic"):
        load_log(path, scan_topic="/rear")
    with pytest.raises(ValueError, match=r"scan_topic /odom holds no .*LaserScan; there are .*/rear \("):
        load_log(path, scan_topic="/odom")
    log = load_log(path, scan_topic="rear", odom_topic="/fused")
    assert log.ranges[0, 0] == 3.0
    assert log.odometry[1, 0] == 2.0
    assert "no transforms from 'base_link' to 'laser'" in caplog.text


@pytest.mark.parametrize(
    ("kind", "arguments", "complaint"),
    [
        ("scan", (102.0, [1.0]), "/scan: scan 2 has 1 beams where earlier ones have 2"),
        ("scan", (102.0, [1.0, 2.0], "laser", -3.0), "/scan: scan 2 has beams from"),
        ("scan", (50.0, [1.0, 2.0]), "/scan: the clock runs back from 101.000 to 50.000 s at message 2"),
        ("odometry", (50.0, 0.0, 0.0, 0.0), "/odom: the clock runs back from 101.000 to 50.000 s"),
        ("odometry", (102.0, NAN, 0.0, 0.0), "/odom: pose .nan, 0.0. m at 102.000 s is not finite"),
        ("odometry", (102.0, 0.0, 0.0, NAN), "/odom at 102.000 s: quaternion .* is no rotation"),
        ("odometry", (102.0, 0.0, 0.0, 0.0, "other"), "/odom holds odometry of several frames"),
    ],
)
def test_bad_messages_are_named(tmp_path, kind, arguments, complaint):
    def messages(m):
        for topic, name, values in (("/odom", "odometry", (0.0, 0.0, 0.0)), ("/scan", "scan", ([1.0, 2.0],))):
            for k in range(4):
                is_bad = name == kind and k == 2
                yield topic, getattr(m, name)(*(arguments if is_bad else (100.0 + k, *values)))

    path = write_bag(tmp_path / "drive", messages)
    with pytest.raises(ValueError, match=complaint) as caught:
        load_log(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("range_max", [INF, 3e38, 0.0])
def test_absurd_range_limits_need_one_of_the_users(tmp_path, range_max):
    path = standing(tmp_path, [1.0, 50.0], range_max=range_max)
    with pytest.raises(ValueError, match=r"range limit \(maxr\) is .* it must lie in"):
        load_log(path)
    if range_max:
        np.testing.assert_array_equal(load_log(path, max_range=20.0).ranges[0], [1.0, INF])


def test_a_tilted_lidar_and_clocks_apart_are_refused(tmp_path):
    def apart(m):
        yield "/odom", m.odometry(1.0, 0.0, 0.0, 0.0)
        yield "/scan", m.scan(1e9, [1.0, 2.0])

    with pytest.raises(ValueError, match="/scan: the lidar is tilted by 57 degrees"):
        load_log(standing(tmp_path, [1.0, 2.0], 0.0, 0.0, 0.0, 1.0))
    with pytest.raises(ValueError, match="do not overlap"):
        load_log(write_bag(tmp_path / "apart", apart))


def test_a_bag_without_scans_says_what_it_holds(tmp_path):
    with pytest.raises(ValueError, match=r"holds no .*; there are /odom \(nav_msgs/msg/Odometry, 1 messages\)"):
        load_log(write_bag(tmp_path / "odom", lambda m: [("/odom", m.odometry(0.0, 0.0, 0.0, 0.0))]))
    with pytest.raises(ValueError, match=r"holds no .*LaserScan; there are no topics"):
        load_log(write_bag(tmp_path / "empty", lambda m: []))
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "metadata.yaml").write_text("rosbag2_bagfile_information: 3\n")
    with pytest.raises(ValueError, match="damaged or no bag"):
        load_log(tmp_path / "broken")

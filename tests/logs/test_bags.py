import math

import numpy as np
import pytest
from rosbags.rosbag1 import reader
from rosbags.rosbag2 import storage_mcap

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.logs import load_log
from tests.logs.bags import drive, write_bag

INF, NAN = math.inf, math.nan


def driving(tmp_path, scans, transforms=(), odometry=()):
    """Write a bag of a drive at 0.1 m/s along x from 10 to 20 s; `scans`: arguments of `Messages.scan`."""

    def messages(m):
        for topic, seconds, *edges in transforms:
            yield topic, m.transforms(seconds, *edges)
        for k in range(11):
            yield "/odom", m.odometry(10.0 + k, 0.1 * k, 0.0, 0.0)
        for name, values in odometry:
            yield name, m.odometry(*values)
        for arguments, fields in scans:
            yield "/scan", m.scan(*arguments, **fields)

    return write_bag(tmp_path / "drive", messages)


def standing(tmp_path, ranges, *mount, **beams):
    """Write a bag of two equal scans; `mount`: (x, y, yaw, roll) of the lidar."""
    transforms = [("/tf_static", 0.0, ("base_link", "laser", *mount))] if mount else []
    return driving(tmp_path, [((10.0 + k, ranges), beams) for k in range(2)], transforms)


@pytest.mark.parametrize("storage", ["ros1", "sqlite3", "mcap", "file", "sqlite3 FILE", "mcap FILE"])
def test_bags_of_all_kinds(tmp_path, storage):
    log = load_log(write_bag(tmp_path / "drive", drive, *storage.split()))
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
    with pytest.raises(ValueError, match=r"drive(\.bag)?: .*unpacks to more than 100 bytes"):
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
        ("scan", (102.0, [1.0, 2.0], "other"), "/scan holds scans of several frames: laser, other; .*--laser-frame"),
        ("scan", (50.0, [1.0, 2.0]), "/scan: the clock runs back from 101.000 to 50.000 s at message 2"),
        ("odometry", (50.0, 0.0, 0.0, 0.0), "odometry of base_link: the clock runs back from 101.000 to 50.000 s"),
        ("odometry", (102.0, 0.0, 0.0, 0.0, "other"), "frames: base_link in odom, other in odom; .*--base-frame"),
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


def test_bags_without_usable_scans_are_refused(tmp_path):
    def apart(m):
        yield "/odom", m.odometry(1.0, 0.0, 0.0, 0.0)
        yield "/scan", m.scan(1e9, [1.0, 2.0])

    with pytest.raises(ValueError, match="/scan: the lidar is tilted by 57 degrees"):
        load_log(standing(tmp_path, [1.0, 2.0], 0.0, 0.0, 0.0, 1.0))
    with pytest.raises(ValueError, match="do not overlap"):
        load_log(write_bag(tmp_path / "apart", apart))
    with pytest.raises(ValueError, match=r"holds no .*; there are /odom \(nav_msgs/msg/Odometry, 1 messages\)"):
        load_log(write_bag(tmp_path / "odom", lambda m: [("/odom", m.odometry(0.0, 0.0, 0.0, 0.0))]))
    with pytest.raises(ValueError, match=r"holds no .*LaserScan; there are no topics"):
        load_log(write_bag(tmp_path / "empty", lambda m: []))
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "metadata.yaml").write_text("rosbag2_bagfile_information: 3\n")
    with pytest.raises(ValueError, match="damaged or not a bag"):
        load_log(tmp_path / "broken")


ROOM = [(-2.0, -3.0, 4.0, -3.0), (4.0, -3.0, 4.0, 3.5), (4.0, 3.5, -2.0, 3.5), (-2.0, 3.5, -2.0, -3.0)]


def cast(x, y, angles):
    """Distances to the walls of a room, shape of `angles`, float64 [m]."""
    c, s = np.cos(angles), np.sin(angles)
    best = np.full(np.shape(angles), INF)
    with np.errstate(divide="ignore", invalid="ignore"):
        for x0, y0, x1, y1 in ROOM:
            ex, ey = x1 - x0, y1 - y0
            det = c * ey - s * ex
            r, u = ((x0 - x) * ey - (y0 - y) * ex) / det, ((x0 - x) * s - (y0 - y) * c) / det
            best = np.where((r > 0) & (u >= -1e-9) & (u <= 1 + 1e-9), np.minimum(best, r), best)
    return best


def errors(log, poses=None):
    """Return errors of returns against the room, shape (m, num_beams) [m], NaN without a return."""
    mount, angles = log.lidar.mount, log.lidar.angles
    poses = log.odometry[log.scan_rows] if poses is None else poses
    found = []
    for (x, y, theta), ranges in zip(poses, log.ranges):
        at = Pose2D(x, y, theta).compose(Pose2D(mount.x, mount.y, mount.yaw))
        found.append(np.abs(cast(at.x, at.y, at.theta + angles) - np.where(np.isfinite(ranges), ranges, np.nan)))
    return np.array(found)


def test_each_scan_has_its_own_limits_and_swapped_ones_need_both(tmp_path):
    limits = [(0.1, 3.0), (0.1, 12.0), (1.5, 3.0), (NAN, 3.0), *((0.1, high) for high in (0.0, INF, 3e38, NAN, -1.0))]
    fields = [{"range_min": low, "range_max": high} for low, high in limits]
    path = driving(tmp_path, [((10.0 + k, [1.0, 5.0, 2.0]), each) for k, each in enumerate(fields)])
    log = load_log(path)
    np.testing.assert_array_equal(log.ranges, [[1, INF, 2], [1, 5, 2], [NAN, INF, 2]])
    assert (log.lidar.range_min, log.lidar.range_max) == pytest.approx((0.1, 12.0))
    assert any("5 of 9 scans are left out: range limit of 0 m; set max_range" in note for note in log.notes)
    assert any("1 of 9 scans are left out: minimum range nan m" in note for note in log.notes)
    log = load_log(path, max_range=4.0, min_range=1.2)
    np.testing.assert_array_equal(log.ranges, [[NAN, INF, 2]] * 9)
    path = driving(tmp_path / "swapped", [((10.0, [1.0, 5.0]), {"range_min": 12.0, "range_max": 0.1})])
    with pytest.raises(ValueError, match=r"minimum range 12 m, maximum range 0.1 m; .*--min-range.*--max-range"):
        load_log(path)
    np.testing.assert_array_equal(load_log(path, 12.0, min_range=2.0).ranges, [[NAN, 5.0]])


@pytest.mark.parametrize("counts", [(360, 361, 358, 359), (0, 360, 300, 361), (450, 1, 455, 447)])
def test_scans_of_varying_length_lie_on_common_beams(tmp_path, counts):
    scans = []
    for k, count in enumerate(counts):
        step = math.radians(1.0) if 300 in counts else 2.0 * math.pi / max(count, 1)
        ranges = cast(0.1 * k, 0.0, -math.pi + step * np.arange(count))
        scans.append(((10.0 + k, ranges), {"angle_min": -math.pi, "step": step, "range_max": 12.0}))
    log = load_log(driving(tmp_path, scans))
    usable = [count for count in counts if count > 1]
    assert len(log.ranges) == len(usable)
    assert any("scans are left out" in note for note in log.notes) == (len(usable) < len(counts))
    off = errors(log)
    assert np.nanmax(off) < 0.05  # except at corners
    for row, count in zip(off, usable):
        assert np.isnan(row).mean() == pytest.approx(max(0.0, 1.0 - count / 360) if 300 in counts else 0.0, abs=0.01)


def test_scans_of_different_fields_keep_their_angles(tmp_path):
    wide = {"angle_min": -2.0, "step": 0.02, "range_max": 12.0}, -2.0 + 0.02 * np.arange(201)
    narrow = {"angle_min": 0.3, "step": 0.01, "range_max": 12.0}, 0.3 + 0.01 * np.arange(101)
    scans = []
    for k, (fields, angles) in enumerate([wide, narrow] * 3):
        scans.append(((10.0 + k, cast(0.1 * k, 0.0, angles)), fields))
    log = load_log(driving(tmp_path, scans))
    assert np.nanmax(errors(log)) < 0.05
    angles = log.lidar.angles + log.lidar.mount.yaw
    is_inside = (angles > 0.31) & (angles < 1.29)
    assert np.isfinite(log.ranges[1::2, is_inside]).all()
    assert np.isnan(log.ranges[1::2][:, (angles < 0.28) | (angles > 1.32)]).all()


def test_a_panning_lidar_is_placed_at_the_time_of_each_scan(tmp_path):
    edges = [("/tf_static", 0.0, ("base_link", "servo", 0.2, 0.1, 0.0, 0.0))]
    edges += [("/tf", 10.5 + k, ("servo", "laser", 0.1, 0.0, 0.6 * k - 2.0, 0.0)) for k in range(8)]
    scans = []
    for k in range(9):
        turn = 0.6 * (k - 0.5) - 2.0
        at = Pose2D(0.1 * k + 0.2, 0.1, 0.0).compose(Pose2D(0.1, 0.0, turn))
        angles = -0.5 + 0.01 * np.arange(101)
        fields = {"angle_min": -0.5, "step": 0.01, "range_max": 12.0}
        scans.append(((10.0 + k, cast(at.x, at.y, turn + angles)), fields))
    log = load_log(driving(tmp_path, scans, edges))
    assert log.notes == ("2 of 9 scans are left out: there is no transform between base and lidar at their time",)
    assert np.nanmax(errors(log)) < 0.03
    assert (np.isfinite(log.ranges).sum(axis=1) > 90).all()


def test_one_bad_transform_and_frames_that_nobody_needs_do_no_harm(tmp_path):
    edges = [("/tf", 9.0 + k, ("base_link", "laser", 0.2, 0.0, NAN if k == 3 else 0.1, 0.0)) for k in range(12)]
    edges.append(("/tf", 9.0, ("base_link", "wheel", NAN, 0.0, NAN, 0.0)))
    edges.append(("/tf", 9.0, ("wheel", "wheel", 0.0, 0.0, 0.0, 0.0)))
    log = load_log(driving(tmp_path, [((15.0, [1.0, 2.0, 3.0, 2.0, 1.0]), {})], edges))
    assert (log.lidar.mount.x, log.lidar.mount.yaw) == pytest.approx((0.2, 0.1), abs=1e-6)
    assert log.notes == ("1 transforms or poses of 'laser' are ignored: not finite, or invalid rotation",)


def test_trees_of_other_namespaces_stay_apart(tmp_path):
    def messages(m):
        for name, x in (("/robot1", 0.1), ("/robot2", 0.3), ("", 0.5)):
            yield f"{name}/tf_static", m.transforms(0.0, ("base_link", "laser", x, 0.0, 0.0, 0.0))
            for k in range(3):
                yield f"{name}/tf", m.transforms(10.0 + k, ("odom", "base_link", x * k, 0.0, 0.0, 0.0))
                yield f"{name}/front/scan", m.scan(10.0 + k, [1.0, 2.0])

    path = write_bag(tmp_path / "drive", messages)
    for name, x in (("/robot1", 0.1), ("/robot2", 0.3), ("", 0.5)):
        log = load_log(path, scan_topic=f"{name}/front/scan")
        assert log.lidar.mount.x == pytest.approx(x)
        np.testing.assert_allclose(log.odometry[:, 0], [0.0, x, 2 * x])


def test_one_of_several_lidars_on_a_topic_is_chosen_by_its_frame(tmp_path):
    edges = ("base_link", "front", 0.2, 0.0, 0.0, 0.0), ("base_link", "rear", -0.2, 0.0, math.pi, 0.0)
    scans = [((10.0 + k, [1.0 + k, 2.0, 3.0], "rear" if k % 2 else "front"), {}) for k in range(6)]
    path = driving(tmp_path, scans, [("/tf_static", 0.0, *edges)])
    with pytest.raises(ValueError, match=r"frames: front, rear; choose one by laser_frame \(--laser-frame\)"):
        load_log(path)
    for frame, x, first in (("front", 0.2, 1.0), ("/rear", -0.2, 2.0)):
        log = load_log(path, laser_frame=frame)
        assert (len(log.ranges), log.lidar.mount.x, log.ranges[0, 0]) == (3, pytest.approx(x), first)


def test_frames_of_other_names(tmp_path):
    def messages(m):
        yield "/tf_static", m.transforms(0.0, ("base_footprint", "torso", 0.1, 0.0, math.pi / 2, 0.0))
        yield "/tf_static", m.transforms(0.0, ("torso", "hokuyo", 0.0, 0.2, 0.0, 0.0))
        for k in range(3):
            yield "/tf", m.transforms(10.0 + k, ("odom_combined", "base_footprint", 1.0 * k, 0.0, 0.0, 0.0))
            yield "/scan", m.scan(10.0 + k, [1.0, 2.0], "laser")

    path = write_bag(tmp_path / "drive", messages)
    with pytest.raises(ValueError, match=r"no odometry from odom; frames are .*odom_combined.*--odom-frame"):
        load_log(path)
    with pytest.raises(ValueError, match=r"laser_frame sick is unknown; scans have laser, transforms .*hokuyo"):
        load_log(path, odom_frame="odom_combined", laser_frame="sick")
    with pytest.raises(ValueError, match=r"base_frame nowhere is unknown; scans have laser, transforms .*torso"):
        load_log(path, odom_frame="odom_combined", laser_frame="hokuyo", base_frame="nowhere")
    log = load_log(path, odom_frame="odom_combined", laser_frame="hokuyo")
    assert (log.lidar.mount.x, log.lidar.mount.y) == pytest.approx((-0.1, 0.0), abs=1e-6)
    np.testing.assert_allclose(log.odometry, [[0, 0, 0], [1, 0, 0], [2, 0, 0]], atol=1e-9)
    log = load_log(path, odom_frame="/odom_combined", laser_frame="hokuyo", base_frame="torso")
    assert (log.lidar.mount.x, log.lidar.mount.y) == pytest.approx((0.0, 0.2), abs=1e-6)
    np.testing.assert_allclose(log.odometry[:, :2], [[0.1, 0], [1.1, 0], [2.1, 0]], atol=1e-9)


def test_scans_and_poses_that_are_left_out_are_counted(tmp_path):
    scans = [((5.0 + k, [1.0, 2.0]), {}) for k in range(20)]
    bad = [("/odom", (20.5, NAN, 0.0, 0.0)), ("/odom", (20.6, 0.0, 0.0, NAN)), ("/odom", (20.7, 1.07, 0.0, 0.0))]
    log = load_log(driving(tmp_path, scans, odometry=bad))
    assert len(log.ranges) == 11
    assert "9 of 20 scans are left out: outside the time of the odometry, 10.000 to 20.700 s" in log.notes
    assert "2 transforms or poses of 'base_link' are ignored: not finite, or invalid rotation" in log.notes


def test_readers_of_rosbags_itself_are_unchanged():
    for module, unpackers in ((reader, reader.decompressors), (storage_mcap, storage_mcap.DECOMPRESSORS)):
        used = [*vars(module).values(), *unpackers.values()]
        assert [each for each in used if (getattr(each, "__module__", None) or "").startswith("lidarnaut")] == []

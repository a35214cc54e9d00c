import gzip

import numpy as np
import pytest

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.logs import load_log
from lidarnaut.envs.logs.trajectory import bridge_glitches

CARMEN = """\
# a comment
PARAM robot_frontlaser_offset 0.2 nohost 0
ODOM 0 0 0 0 0 0 10.0 nohost 10.0
FLASER 3 1.0 2.0 90.0 0.2 0 0 0 0 0 10.5 nohost 10.5
ODOM 1 0 0.5 0 0 0 11.0 nohost 11.0
FLASER 3 1.5 2.5 3.5 1.0 1.2 1.57 1 1 1.57 12.0 nohost 12.0
"""
ROBOTLASER = (
    "ROBOTLASER1 0 -1.0 2.0 1.0 20.0 0.01 0 3 1.0 25.0 3.0 0 1.1 2.0 1.57 1.0 2.0 1.57 0 0 0 0 0 100.5 nohost 0.5\n"
)


def test_carmen_log(tmp_path):
    path = tmp_path / "drive.log.gz"
    path.write_bytes(gzip.compress(CARMEN.encode()))
    log = load_log(path)
    np.testing.assert_allclose(log.times, [10.0, 10.5, 11.0, 12.0])
    np.testing.assert_allclose(log.odometry, [[0, 0, 0], [0, 0, 0], [1, 0, 0.5], [1, 1, 1.57]])
    np.testing.assert_array_equal(log.scan_rows, [1, 3])
    np.testing.assert_allclose(log.ranges, [[1.0, 2.0, np.inf], [1.5, 2.5, 3.5]])
    angles = log.lidar.angles + log.lidar.mount.yaw
    np.testing.assert_allclose(angles, np.radians([-90.0, 0.0, 90.0]), atol=1e-12)
    assert (log.lidar.range_max, log.lidar.mount.x) == (80.0, 0.2)
    assert load_log(path, max_range=3.0).ranges[1, 2] == np.inf
    start, step = log.motions()
    assert start == (0, 0, 0)
    np.testing.assert_allclose(step, (1, 1, 1.57))
    with pytest.raises(FileNotFoundError, match=r"missing\.log"):
        load_log(tmp_path / "missing.log")


def test_robotlaser_log(tmp_path):
    path = tmp_path / "drive.clf"
    path.write_text(ROBOTLASER)
    log = load_log(path)
    np.testing.assert_allclose(log.odometry, [[1.0, 2.0, 1.57]])
    np.testing.assert_allclose(log.times, [100.5])
    np.testing.assert_allclose(log.ranges, [[1.0, np.inf, 3.0]])
    np.testing.assert_allclose(log.lidar.angles + log.lidar.mount.yaw, [-1.0, 0.0, 1.0], atol=1e-12)
    assert (log.lidar.mount.x, log.lidar.mount.y) == pytest.approx((0.0, -0.1), abs=1e-4)


def robotlaser(mount, step=1.0, first=-1.0, count=3, poses=None):
    """Lines of a robot that drives and turns, with a laser at `mount` (x, y, yaw)."""
    lines = []
    for k in range(3):
        pose = Pose2D(6.0 + 0.1 * k, 8.0, 0.5 + 0.2 * k)
        laser = pose.compose(Pose2D(*mount)) if poses is None else poses[k]
        ranges = " ".join(str(1.0 + beam) for beam in range(count))
        numbers = " ".join(f"{value:.6f}" for value in (*laser, *pose))
        beams = f"{first} 2.0 {step} 20.0 0.01 0 {count} {ranges}"
        lines.append(f"ROBOTLASER1 0 {beams} 0 {numbers} 0 0 0 0 0 {k}.0 host {k}.0\n")
    return lines


def flaser(count):
    ranges = " 2.0" * count
    return "".join(f"FLASER {count}{ranges} 0 0 0 {x} 0 0 {10 * x} host {10 * x}\n" for x in (0.0, 0.1))


FIRST = robotlaser((0, 0, 0))[0]


@pytest.mark.parametrize(
    ("name", "content", "complaint"),
    [
        ("drive.txt", "", "unknown type of log"),
        ("none.log", "", "holds no FLASER or ROBOTLASER1"),
        ("cut.log", CARMEN[:-30], "line 6: bad FLASER line"),
        ("end.log", CARMEN[:-6], "line 6: bad FLASER line: 12 fields instead of 13: truncated"),
        ("word.log", CARMEN.replace("2.5", "two"), "line 6: bad FLASER line.*two"),
        ("beams.log", CARMEN.replace("3 1.5 2.5", "2 2.5"), "line 6: .*2 beams, earlier scans 3"),
        ("nan.log", CARMEN.replace("1 0 0.5", "1 nan 0.5"), "line 5: bad ODOM line: .*, got nan"),
        ("time.log", CARMEN.replace("12.0 nohost", "inf nohost"), "line 6: .*inf"),
        ("beam.log", CARMEN.replace("2.5", "nan"), "line 6: bad FLASER line: beam 1 is NaN"),
        ("count.log", "FLASER " + "9" * 4000 + " 1\n", "line 1: bad FLASER line: .*too large"),
        ("back.log", CARMEN.replace("12.0 nohost", "9.0 nohost"), "back.log: the clock runs back from 10.5"),
        ("below.log", CARMEN.replace("2.5", "-2.5"), "beam 1 of scan 1 is -2.5 m"),
        ("maxr.clf", ROBOTLASER.replace("20.0", "inf"), "no scan can be used: range limit of inf m; .*--max-range"),
        ("cut.log.gz", gzip.compress(CARMEN.encode())[:-20], "cut.log.gz: damaged or truncated"),
        ("text.log.gz", CARMEN, "text.log.gz: damaged or truncated"),
        ("mount.log", "".join(robotlaser((0, 0, 0), poses=[(0, 0, 0)] * 3)), "line 1: .*laser and robot do not agree"),
        ("step.log", FIRST + robotlaser((0, 0, 0), step=0.5)[1], "line 2: .*.step. is 0.5, earlier 1"),
        ("first.log", FIRST + robotlaser((0, 0, 0), first=0.0)[1], "line 2: .*configuration .first. is 0"),
        ("one.log", "".join(robotlaser((0, 0, 0), count=1)), "no scan can be used: 1 beams; from 2"),
        ("turn.log", "".join(robotlaser((0, 0, 0), step=90.0)), "3 beams .* than a turn; are the angles in degrees"),
        ("fine.log", flaser(1081), "line 1: .*1081 beams would be 0.167 degrees apart.*--field-of-view"),
    ],
)
def test_bad_logs_are_named(tmp_path, name, content, complaint):
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ValueError, match=complaint):
        load_log(path)


ARRAYS = {"t": np.arange(3.0), "odo": np.zeros((3, 3)), "idx": np.arange(3), "ranges": np.ones((3, 4))}
ARRAYS |= {"ang0": -1.0, "dang": 0.5, "maxr": 8.0}


def write_arrays(folder, **changes):
    """Write an archive with changed arrays, or without arrays set to None; return its path."""
    arrays = {name: array for name, array in (ARRAYS | changes).items() if array is not None}
    np.savez_compressed(folder / "drive.npz", **arrays)
    return folder / "drive.npz"


def test_archive_of_any_number_type(tmp_path):
    ranges = np.full((3, 4), [1.0, np.nan, 8.0, 9.0])
    log = load_log(write_arrays(tmp_path, ranges=ranges, off=5.0, mount_x=0.3))
    np.testing.assert_array_equal(log.ranges, [[1.0, np.nan, np.inf, np.inf]] * 3)
    np.testing.assert_array_equal(log.times, [5.0, 6.0, 7.0])
    np.testing.assert_allclose(log.lidar.angles + log.lidar.mount.yaw, [-1.0, -0.5, 0.0, 0.5])
    assert log.lidar.mount.x == 0.3
    for dtype in (np.float16, np.int8):
        changes = {name: ARRAYS[name].astype(dtype) for name in ("t", "odo", "ranges")}
        log = load_log(write_arrays(tmp_path, **changes))
        assert (log.times.dtype, log.odometry.dtype, log.ranges.dtype) == (np.float64, np.float64, np.float32)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"ranges": None}, r"lacks the arrays \['ranges'\]"),
        ({"ranges": np.array([np.ones(4), np.ones(3), np.ones(4)], dtype=object)}, "array ranges: .*allow_pickle"),
        ({"ranges": np.ones(12)}, r"array ranges: must have numbers in 2 dimensions, got float64 \(12,\)"),
        ({"odo": np.zeros((3, 2))}, "array odo: must have rows of x, y, heading"),
        ({"odo": np.full((3, 3), np.nan)}, r"must be finite, row 0 is 0.0 s, \[nan"),
        ({"t": np.array([0.0, np.nan, 1.0])}, "must be finite, row 1 is nan s"),
        ({"t": np.array([0.0, 50.0, 1.0])}, "the clock runs back from 50.000 to 1.000 s at scan 2"),
        ({"t": np.arange(2.0)}, "numbers of times, poses and scans do not agree"),
        ({"idx": np.array([0, 1, 7])}, "rows of odometry that do not exist"),
        ({"ranges": np.ones((0, 4)), "idx": np.arange(0)}, "no scan can be used: there are none"),
        ({"maxr": 1e9}, r"range limit of 1e\+09 m"),
        ({"maxr": np.nan}, r"range limit of nan m"),
        ({"dang": 0.0}, "in steps of 0 rad"),
        ({"dang": np.nan}, "in steps of nan rad"),
        ({"idx": np.array([0.0, 1.0, np.nan])}, "array idx: must be finite"),
        ({"idx": np.array([2, 1, 0])}, "the clock runs back from 2.000 to 0.000 s at scan 2"),
        ({"ranges": np.ones((3, 0))}, "0 beams; from 2 to 20,000 are allowed"),
        ({"ranges": np.ones((3, 30_000)), "dang": 1e-5}, "30000 beams; from 2 to 20,000"),
        ({"mount_x": 1e12}, r"lidar at \(1000000000000.0, 0.0, 0.0\) m in the base frame; at most 100 m"),
        (
            {"t": np.arange(9.0), "odo": 1e9 * np.arange(27.0).reshape(9, 3), "idx": np.arange(2, 5)},
            r"odometry moves by 4.24\d*e\+09 m from scan 0 to the next",
        ),
    ],
)
def test_bad_archives_are_named(tmp_path, changes, complaint):
    path = write_arrays(tmp_path, **changes)
    with pytest.raises(ValueError, match=complaint) as caught:
        load_log(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("x", "y", "yaw"), [(0.2, 0, 0), (-0.2, 0.1, 0), (0, 0.3, np.pi), (0.1, 0, -2.0)])
def test_the_mount_is_the_laser_pose_seen_from_the_robot_pose(tmp_path, x, y, yaw):
    (tmp_path / "drive.log").write_text("".join(robotlaser((x, y, yaw))))
    mount = load_log(tmp_path / "drive.log").lidar.mount
    assert (mount.x, mount.y) == pytest.approx((x, y), abs=1e-5)
    assert np.cos(mount.yaw - yaw) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("count", "first", "step"),
    [(180, -90, 1), (181, -90, 1), (360, -90, 0.5), (361, -90, 0.5), (401, -50, 0.25), (61, -90, 3), (541, -90, 1 / 3)],
)
def test_flaser_lines_have_the_angles_of_carmen(tmp_path, caplog, count, first, step):
    (tmp_path / "drive.log").write_text(flaser(count) + "FLASER 0 0 0 0 0 0 0 9.0 host 9.0\n")
    lidar = load_log(tmp_path / "drive.log").lidar
    assert np.degrees(lidar.angle_increment) == pytest.approx(step)
    assert np.degrees(lidar.angle_min + lidar.mount.yaw) == pytest.approx(first)
    assert ("assuming 180 degrees" in caplog.text) == (count in (61, 541))
    assert "1 of 3 scans are left out: they have no beams" in caplog.text
    wide = load_log(tmp_path / "drive.log", field_of_view=np.radians(270.0)).lidar
    assert np.degrees(wide.angles[[0, -1]] + wide.mount.yaw) == pytest.approx([-135.0, 135.0])


def test_odometry_is_bridged_where_both_neighbours_fit():
    times = 0.1 * np.arange(60)
    right = np.column_stack([0.5 * times, 0.1 * times, np.full(60, 3.1) + 0.2 * times])
    right[:, 2] = (right[:, 2] + np.pi) % (2 * np.pi) - np.pi
    for rows, offset in ((slice(30, 31), (20.0, 0, 0)), (slice(30, 36), (0, -9.0, 0)), (slice(40, 42), (0, 0, 2.5))):
        poses = right.copy()
        poses[rows] += offset
        fixed, (said,) = bridge_glitches(times, poses)
        np.testing.assert_allclose(fixed[:, :2], right[:, :2], atol=1e-9)
        assert np.cos(fixed[:, 2] - right[:, 2]).min() > 1.0 - 1e-9
        assert f"at {times[rows.start]:.3f} s" in said
        assert f"{rows.stop - rows.start} poses are interpolated" in said
    # The first and the last pose have only one neighbour.
    for row in (0, 59):
        poses = right.copy()
        poses[row, :2] += 5.0
        fixed, (said,) = bridge_glitches(times, poses)
        np.testing.assert_array_equal(fixed, poses)
        assert "1 jumps stay" in said


def test_a_jump_that_stays_is_named_and_not_bridged():
    times = 0.1 * np.arange(100)
    poses = np.column_stack([0.2 * times, np.zeros(100), np.zeros(100)])
    poses[50:] -= poses[50]
    poses[50:, 1] += 7.0
    fixed, (said,) = bridge_glitches(times, poses)
    np.testing.assert_array_equal(fixed, poses)
    assert "odometry moves by 7.0" in said
    assert "at 5.000 s, beyond 5 m/s or 10 rad/s: 1 jumps stay" in said
    assert bridge_glitches(times, np.zeros((100, 3)))[1] == []
    # Limits depend on the robot: limits, stamps or units are wrong, and the log stays unchanged.
    poses = np.column_stack([4.0 * times, np.zeros(100), np.zeros(100)])
    assert bridge_glitches(times, poses)[1] == []
    fixed, (said,) = bridge_glitches(times, poses, (0.33, 3.0))
    np.testing.assert_array_equal(fixed, poses)
    assert "beyond 0.33 m/s or 3 rad/s: 99 of 99 motions are impossible; check stamps, units and limits" in said
    # Coarse stamps are no glitches.
    poses = np.column_stack([0.16 * np.arange(100), np.zeros(100), np.zeros(100)])
    for stamps in (np.zeros(100), np.floor(0.2 * np.arange(100)), 0.2 * (np.arange(100) // 4 * 4)):
        assert bridge_glitches(stamps, poses)[1] == []


def test_small_files_that_unpack_to_any_size_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("lidarnaut.envs.files.archives.MAX_BYTES", 100_000)
    with pytest.raises(ValueError, match=r"drive\.npz: unpacks to .* bytes; at most 100,000"):
        load_log(write_arrays(tmp_path, ranges=np.ones((3, 10_000))))
    path = tmp_path / "drive.log.gz"
    path.write_bytes(gzip.compress(b"x" * 3_000_000))
    with pytest.raises(ValueError, match=r"drive\.log\.gz: too long; at most 1,000,000 characters in a line"):
        load_log(path)
    monkeypatch.setattr("lidarnaut.envs.logs.readers.MAX_TEXT", 1000)
    path.write_bytes(gzip.compress(b"#\n" * 600))
    with pytest.raises(ValueError, match=r"drive\.log\.gz: too long"):
        load_log(path)


@pytest.mark.parametrize("cut", range(20, len(ROBOTLASER), 7))
def test_lines_that_are_cut_off_anywhere_are_named(tmp_path, cut):
    path = tmp_path / "drive.clf"
    path.write_text(ROBOTLASER + ROBOTLASER[:cut])
    with pytest.raises(ValueError, match=r"drive\.clf, line 2: bad ROBOTLASER1 line"):
        load_log(path)

import gzip

import numpy as np
import pytest

from lidarnaut.envs.logs import load_log

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
    np.testing.assert_allclose(angles, np.radians([-90.0, -89.0, -88.0]), atol=1e-12)
    assert (log.lidar.range_max, log.lidar.mount.x) == (80.0, 0.2)
    assert load_log(path, max_range=3.0).ranges[1, 2] == np.inf
    start, step = log.motions()
    assert start == (0, 0, 0)
    np.testing.assert_allclose(step, (1, 1, 1.57))


def test_robotlaser_log(tmp_path):
    path = tmp_path / "drive.clf"
    path.write_text(ROBOTLASER)
    log = load_log(path)
    np.testing.assert_allclose(log.odometry, [[1.0, 2.0, 1.57]])
    np.testing.assert_allclose(log.times, [100.5])
    np.testing.assert_allclose(log.ranges, [[1.0, np.inf, 3.0]])
    np.testing.assert_allclose(log.lidar.angles + log.lidar.mount.yaw, [-1.0, 0.0, 1.0], atol=1e-12)
    assert log.lidar.mount.x == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("name", "content", "complaint"),
    [
        ("drive.txt", "", "unknown kind of log"),
        ("none.log", "", "holds no FLASER or ROBOTLASER1"),
        ("cut.log", CARMEN[:-30], "line 6: bad FLASER line"),
        ("end.log", CARMEN[:-6], "line 6: bad FLASER line: cut off, 12 of 13 fields"),
        ("word.log", CARMEN.replace("2.5", "two"), "line 6: bad FLASER line.*two"),
        ("beams.log", CARMEN.replace("3 1.5 2.5", "2 2.5"), "line 6: .*2 beams where earlier scans have 3"),
        ("nan.log", CARMEN.replace("1 0 0.5", "1 nan 0.5"), "line 5: bad ODOM line: nan"),
        ("time.log", CARMEN.replace("12.0 nohost", "inf nohost"), "line 6: .*inf"),
        ("beam.log", CARMEN.replace("2.5", "nan"), "line 6: bad FLASER line: beam 1 is NaN"),
        ("back.log", CARMEN.replace("12.0 nohost", "9.0 nohost"), "back.log: the clock runs back from 10.5"),
        ("below.log", CARMEN.replace("2.5", "-2.5"), "beam 1 of scan 1 is -2.5 m"),
        ("maxr.clf", ROBOTLASER.replace("20.0", "inf"), r"maxr.clf: the range limit \(maxr\) is inf m"),
        ("cut.log.gz", gzip.compress(CARMEN.encode())[:-20], "cut.log.gz: damaged or cut off"),
        ("text.log.gz", CARMEN, "text.log.gz: damaged or cut off"),
    ],
)
def test_bad_logs_are_named(tmp_path, name, content, complaint):
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ValueError, match=complaint):
        load_log(path)


def test_a_missing_log_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"missing\.log"):
        load_log(tmp_path / "missing.log")


ARRAYS = {"t": np.arange(3.0), "odo": np.zeros((3, 3)), "idx": np.arange(3), "ranges": np.ones((3, 4))}
ARRAYS |= {"ang0": -1.0, "dang": 0.5, "maxr": 8.0}


def write_arrays(folder, **changes):
    """Write an archive in which some arrays differ, or are missing where they are None; return its path."""
    arrays = {name: array for name, array in (ARRAYS | changes).items() if array is not None}
    np.savez_compressed(folder / "drive.npz", **arrays)
    return folder / "drive.npz"


def test_archive(tmp_path):
    ranges = np.full((3, 4), [1.0, np.nan, 8.0, 9.0])
    log = load_log(write_arrays(tmp_path, ranges=ranges, off=5.0, mount_x=0.3))
    np.testing.assert_array_equal(log.ranges, [[1.0, np.nan, np.inf, np.inf]] * 3)
    np.testing.assert_array_equal(log.times, [5.0, 6.0, 7.0])
    np.testing.assert_allclose(log.lidar.angles + log.lidar.mount.yaw, [-1.0, -0.5, 0.0, 0.5])
    assert log.lidar.mount.x == 0.3


@pytest.mark.parametrize("dtype", [np.float16, np.int8])
def test_arrays_of_any_number_type_are_read(tmp_path, dtype):
    changes = {name: ARRAYS[name].astype(dtype) for name in ("t", "odo", "ranges")}
    log = load_log(write_arrays(tmp_path, **changes))
    assert (log.times.dtype, log.odometry.dtype, log.ranges.dtype) == (np.float64, np.float64, np.float32)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"ranges": None}, r"lacks the arrays \['ranges'\]"),
        ({"ranges": np.array([np.ones(4), np.ones(3), np.ones(4)], dtype=object)}, "array ranges: .*allow_pickle"),
        ({"ranges": np.ones(12)}, r"array ranges: numbers in 2 dimensions are needed, got float64 \(12,\)"),
        ({"odo": np.zeros((3, 2))}, "array odo: rows of x, y, heading"),
        ({"odo": np.array([[0, 0, 0], [0, np.nan, 0], [0, 0, 0]])}, r"must be finite, row 1 is 1.0 s, \[0.0, nan"),
        ({"t": np.array([0.0, np.nan, 1.0])}, "must be finite, row 1 is nan s"),
        ({"t": np.array([0.0, 50.0, 1.0])}, "the clock runs back from 50.000 to 1.000 s at scan 2"),
        ({"t": np.arange(2.0)}, "numbers of times, poses and scans do not agree"),
        ({"idx": np.array([0, 1, 7])}, "rows of odometry that do not exist"),
        ({"ranges": np.ones((0, 4)), "idx": np.arange(0)}, "holds no scans"),
        ({"maxr": 1e9}, r"range limit \(maxr\) is 1e\+09 m"),
        ({"maxr": np.nan}, r"range limit \(maxr\) is nan m"),
        ({"dang": 0.0}, "in steps of 0.0 rad"),
        ({"dang": np.nan}, "in steps of nan rad"),
        ({"idx": np.array([0.0, 1.0, np.nan])}, "array idx: must be finite"),
        ({"idx": np.array([2, 1, 0])}, "the clock runs back from 2.000 to 0.000 s at scan 2"),
        ({"ranges": np.ones((3, 0))}, "scans have 0 beams, from 1 to 20,000"),
        ({"ranges": np.ones((3, 30_000)), "dang": 1e-5}, "scans have 30000 beams"),
        ({"mount_x": 1e12}, "1000000000000.0 m ahead"),
        ({"odo": np.diag([0.0, 1e9, 0.0])[:, [1, 0, 2]]}, r"odometry moves by 1e\+09 m from scan 0 to the next"),
    ],
)
def test_bad_archives_are_named(tmp_path, changes, complaint):
    path = write_arrays(tmp_path, **changes)
    with pytest.raises(ValueError, match=complaint) as caught:
        load_log(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


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

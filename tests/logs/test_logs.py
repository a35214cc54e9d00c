import gzip

import numpy as np
import pytest

from envs.logs import load_log

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


def test_bad_logs(tmp_path):
    def complain(name, content, complaint, error=ValueError):
        path = tmp_path / name
        if content is not None:
            path.write_bytes(content)
        with pytest.raises(error, match=complaint):
            load_log(path)

    complain("missing.log", None, r"missing\.log", FileNotFoundError)
    complain("drive.bag", b"", "unknown kind of log")
    complain("empty.log", b"ODOM 0 0 0 0 0 0 1 h 1\n", "holds no FLASER or ROBOTLASER1")
    complain("cut.log", CARMEN.encode()[:-30], "line 6: bad FLASER line")
    complain("word.log", CARMEN.replace("2.5", "two").encode(), "line 6: bad FLASER line.*two")
    complain("beams.log", CARMEN.replace("3 1.5 2.5", "2 2.5").encode(), "line 6: .*2 beams where earlier scans have 3")
    np.savez(tmp_path / "part.npz", t=np.zeros(2), odo=np.zeros((2, 3)))
    complain("part.npz", None, "lacks the arrays.*'ranges'")

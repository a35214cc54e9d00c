import gzip
import json
import math
import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from envs.geometry import OccupancyGrid
from envs.slam.logs import load_log
from envs.slam.relations import follow_odometry, load_relations, relation_error
from envs.slam.replay import Options, main, picture

DATA = Path(os.environ.get("LIDARNAUT_DATA", Path(__file__).parents[3] / "shared" / "data")) / "intel"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason=f"the Intel log is not at {DATA}; set LIDARNAUT_DATA")

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
    file.write_text("1 2 3\n")
    with pytest.raises(ValueError, match="8 numbers"):
        load_relations(file)


def test_between_scans_the_trajectory_follows_odometry():
    odometry = np.array([[0, 0, 0], [1, 0, 0], [2, 0, np.pi / 2], [2, 1, np.pi / 2], [2, 2, np.pi / 2]], dtype=float)
    scan_poses = np.array([[10, 0, np.pi / 2], [20, 0, 0]], dtype=float)
    expected = [[10, -1, np.pi / 2], [10, 0, np.pi / 2], [10, 1, np.pi], [20, 0, 0], [21, 0, 0]]
    result = follow_odometry(odometry, np.array([1, 3]), scan_poses)
    np.testing.assert_allclose(result[:, :2], np.array(expected)[:, :2], atol=1e-12)
    np.testing.assert_allclose(np.cos(result[:, 2]), np.cos(np.array(expected)[:, 2]), atol=1e-12)


def test_replay_writes_maps_trajectories_and_a_summary(tmp_path):
    log = tmp_path / "drive.log"
    log.write_text(CARMEN)
    relations = tmp_path / "relations"
    relations.write_text("10.5 12.0 1 1 0 0 0 1.57\n")
    np.save(tmp_path / "unambiguous_relations.npy", np.array([True]))
    out = tmp_path / "out"
    runs = main(
        Options(log, slam="odometry", change={"resolution": "0.1"}, relations=relations, out=out, seeds=2, first_seed=3)
    )
    assert [run.seed for run in runs] == [3, 4]
    assert runs[0].error.translation == pytest.approx(0.0, abs=1e-9)
    assert runs[0].error_unambiguous.count == 1
    for seed in (3, 4):
        trajectory = np.loadtxt(out / f"trajectory_{seed}.tum")
        np.testing.assert_allclose(trajectory[-1], [12, 1, 1, 0, 0, 0, math.sin(0.785), math.cos(0.785)], atol=1e-5)
        assert {f"map_{seed}.pgm", f"map_{seed}.yaml", f"map_with_path_{seed}.png"} <= {p.name for p in out.iterdir()}
    summary = json.loads((out / "summary.json").read_text())
    assert summary["params"]["resolution"] == 0.1
    assert summary["runs"][1]["error"]["count"] == 1


def test_picture_shows_low_y_at_the_bottom():
    data = np.full((30, 40), -1, dtype=np.int8)
    data[12, 20], data[17, 25] = 0, 100
    image = picture(OccupancyGrid(data, 0.1, (0.0, 0.0)), margin=2)
    assert isinstance(image, Image.Image)
    assert image.size == (10, 10)
    assert image.getpixel((2, 7)) == (255, 255, 255)
    assert image.getpixel((7, 2)) == (0, 0, 0)
    assert image.getpixel((0, 0)) == (190, 190, 190)


@needs_data
def test_intel_raw_odometry_has_its_known_error():
    log, relations = load_log(DATA / "scans_2725.npz"), load_relations(DATA / "intel.relations")
    error = relation_error(log.times, log.odometry, relations)
    assert error.count == 2984
    assert error.translation == pytest.approx(7.38, abs=0.01)
    unambiguous = relation_error(log.times, log.odometry, relations[np.load(DATA / "unambiguous_relations.npy")])
    assert unambiguous.translation == pytest.approx(6.66, abs=0.01)


@needs_data
def test_intel_tinyslam():
    (run,) = main(Options(DATA / "scans_2725.npz", relations=DATA / "intel.relations", first_seed=200))
    assert run.error.translation < 0.15
    assert run.error.rotation < 3.0
    assert run.milliseconds < 5.0  # about 0.3 where nothing else runs

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest

from envs.geometry import Pose2D
from envs.robots import OdometryNoise
from envs.simulation import Reading
from envs.slam import PRESETS, SLAM_NAMES, TinySlam, load_params, make_slam

from .rooms import BY_WHEELS, CIRCLE, LIDAR, STAY, WHEELS, drive, scan


def distance(a, b):
    return math.hypot(a.x - b.x, a.y - b.y)


def test_odometry_that_errs_is_corrected():
    truth, estimated = drive(make_slam("tinyslam", LIDAR, preset="every_scan"), CIRCLE, BY_WHEELS)
    _, by_wheels = drive(make_slam("odometry", LIDAR), CIRCLE, BY_WHEELS)
    assert abs(by_wheels.theta - truth.theta) > 0.5
    assert distance(truth, estimated) < 0.06
    assert abs(estimated.theta - truth.theta) < 0.03


def test_weighted_odometry_is_corrected_at_key_scans_alone():
    slam = make_slam("tinyslam", LIDAR, odometry_noise=WHEELS)
    truth, estimated = drive(slam, CIRCLE, BY_WHEELS)
    assert distance(truth, estimated) < 0.06
    assert abs(estimated.theta - truth.theta) < 0.03
    before = slam.belief.pose
    slam.update(Reading.of_scan(scan(truth)), Pose2D(0.01, 0.0, 0.0))
    assert slam.belief.pose == before.compose(Pose2D(0.01, 0.0, 0.0))


def test_firm_odometry_is_not_corrected():
    firm = OdometryNoise(1e-5, 0.0, 1e-5, 0.0, 0.0)
    slam = make_slam("tinyslam", LIDAR, odometry_noise=firm)
    slam.update(Reading.of_scan(scan(STAY)), STAY)
    slam.update(Reading.of_scan(scan(Pose2D(0.25, 0.02, 0.0))), Pose2D(0.22, 0.0, 0.0))
    np.testing.assert_allclose(slam.belief.pose, (0.22, 0.0, 0.0), atol=1e-3)


def test_a_robot_that_stands_still_does_not_drift():
    slam = make_slam("tinyslam", LIDAR)
    _, after_a_second = drive(slam, [STAY] * 10, [STAY] * 10)
    _, after_a_minute = drive(slam, [STAY] * 600, [STAY] * 600)
    assert distance(after_a_second, STAY) < 0.02
    assert distance(after_a_minute, STAY) < 0.02
    assert abs(after_a_minute.theta) < 0.01


def test_same_seed_same_bytes():
    motions = [Pose2D(0.02, 0.0, 0.03)] * 40

    def run(seed):
        slam = make_slam("tinyslam", LIDAR)
        pose = drive(slam, motions, motions, seed)[1]
        return np.array(pose).tobytes() + slam.belief.grid.data.tobytes()

    assert run(3) == run(3)
    assert run(3) != run(4)


def test_belief_is_updated_in_place_and_names_new_cells():
    slam = make_slam("tinyslam", LIDAR)
    belief = slam.reset(np.random.default_rng(0))
    assert (belief.grid.data == -1).all()
    assert len(belief.update.new_cells) == 0
    known = np.zeros(belief.grid.data.shape, dtype=bool)
    for k in range(5):
        assert (
            slam.update(Reading.of_scan(scan(Pose2D(0.3 * k, 0.0, 0.0))), Pose2D(0.3, 0.0, 0.0) if k else STAY)
            is belief
        )
        rows, cols = belief.update.new_cells.T
        assert len(rows) > 0
        assert not known[rows, cols].any()
        known[rows, cols] = True
        np.testing.assert_array_equal(known, belief.grid.data >= 0)
    assert slam.reset(np.random.default_rng(0)) is not belief


def test_scans_are_integrated_when_the_robot_has_moved():
    slam = TinySlam(
        LIDAR, load_params("default", {"min_travel_distance": 0.25, "min_travel_angle": 0.1, "max_tries": 1})
    )
    integrated = []
    for k, motion in enumerate([STAY, *[Pose2D(0.1, 0.0, 0.0)] * 4, *[Pose2D(0.0, 0.0, 0.06)] * 3]):
        before = slam.belief.grid.data.copy()
        slam.update(Reading.of_scan(scan(Pose2D(0.1 * min(k, 4), 0.0, 0.06 * max(k - 4, 0)))), motion)
        integrated.append(not np.array_equal(before, slam.belief.grid.data))
        assert integrated[-1] or len(slam.belief.update.new_cells) == 0
    assert integrated == [True, False, False, True, False, False, True, False]


def test_without_returns_the_prediction_remains():
    slam = make_slam("tinyslam", LIDAR)
    slam.update(Reading.of_scan(scan(STAY)), STAY)
    for ranges in (np.inf, np.nan):
        before = slam.belief.pose
        slam.update(Reading.of_scan(np.full(180, ranges, dtype=np.float32)), Pose2D(0.1, 0.0, 0.2))
        assert slam.belief.pose == before.compose(Pose2D(0.1, 0.0, 0.2))


def test_frames_of_odometry():
    # The estimated heading is turned a quarter against odometry's: forward by the wheels is "along x" or "along y".
    nothing = np.full(180, np.nan, dtype=np.float32)
    for frame, expected in (("robot_frame", (0.0, 1.0)), ("odometry_frame", (1.0, 0.0))):
        slam = TinySlam(LIDAR, load_params("default", {"odometry": frame}))
        slam.belief.pose = Pose2D(0.0, 0.0, math.pi / 2)
        slam.update(Reading.of_scan(nothing), Pose2D(1.0, 0.0, 0.0))
        np.testing.assert_allclose(slam.belief.pose, (*expected, math.pi / 2), atol=1e-12)


def test_observers_see_the_search_and_change_nothing():
    params = load_params("every_scan", {"sigma_xy": 0.05, "sigma_theta": 0.03, "max_failed": 30, "max_tries": 90})
    heard = []
    events = ("on_matching_start", "on_scan_test", "on_pose_update", "on_matching_end")
    witness = SimpleNamespace(**{name: lambda *said, name=name: heard.append((name, *said)) for name in events})
    watched, unwatched = TinySlam(LIDAR, params, [witness]), TinySlam(LIDAR, params)
    moved = Pose2D(0.15, 0.06, 0.05)
    for slam in (watched, unwatched):
        slam.reset(np.random.default_rng(1))
        slam.update(Reading.of_scan(scan(STAY)), STAY)
        slam.update(Reading.of_scan(scan(moved)), STAY)
    assert watched.belief.pose == unwatched.belief.pose
    assert heard[0] == (events[0], STAY)
    assert heard[1][:2] == (events[1], STAY)
    assert 32 <= sum(name == events[1] for name, *_ in heard) <= 91
    updates = [said for name, *said in heard if name == events[2]]
    assert len(updates) >= 2
    assert [cost for _, cost in updates] == sorted((cost for _, cost in updates), reverse=True)
    assert heard[-1] == (events[3], *updates[-1])
    assert heard[-1][1] == watched.belief.pose


@pytest.mark.parametrize(("slam", "name"), [(slam, name) for slam in PRESETS for name in PRESETS[slam]])
def test_presets_map_the_room(slam, name):
    params = load_params(name, {"map_width": 10.0, "map_height": 10.0}, slam)
    estimator = make_slam(slam, LIDAR, params.resolution, params)
    for _ in range(3):
        estimator.update(Reading.of_scan(scan(STAY)), STAY)
    assert distance(estimator.belief.pose, STAY) < (0.3 if slam == "tinyslam" else 0.05)
    assert (estimator.belief.grid.data >= 0).mean() > 0.1


def test_presets_hold_the_documented_numbers():
    report, upstream = load_params("robot_vacuum"), load_params("upstream")
    changed = {"hole_width": 0.05, "sigma_xy": 0.01, "sigma_theta": 0.02}
    assert report == dataclasses.replace(upstream, **changed)
    assert (upstream.hole_width, upstream.sigma_xy, upstream.sigma_theta) == (1.5, 0.2, 0.1)
    assert (upstream.max_failed, upstream.max_tries, upstream.resolution) == (20, 100, 0.1)
    assert (upstream.occupied_prob, upstream.empty_prob) == (0.95, 0.01)


@pytest.mark.parametrize("name", SLAM_NAMES)
def test_bad_input(name):
    slam = make_slam(name, LIDAR)
    with pytest.raises(ValueError, match=r"shape \(180,\).*\(3,\)"):
        slam.update(Reading.of_scan(np.ones(3, dtype=np.float32)), STAY)
    with pytest.raises(ValueError, match="motion must be finite"):
        slam.update(Reading.of_scan(scan(STAY)), Pose2D(0.0, math.nan, 0.0))


def test_bad_params(tmp_path):
    with pytest.raises(ValueError, match=r"unknown SLAM 'hectare'.*tinyslam, hector, graph, gmapping, odometry, truth"):
        make_slam("hectare", LIDAR)
    with pytest.raises(ValueError, match=r"resolution: .*greater than 0, got -1"):
        make_slam("tinyslam", LIDAR, resolution=-1)
    with pytest.raises(ValueError, match=r"unknown preset of tinyslam 'upstraem'.*upstream"):
        load_params("upstraem")
    with pytest.raises(FileNotFoundError, match=r"missing\.yaml"):
        load_params(tmp_path / "missing.yaml")
    file = tmp_path / "mine.yaml"
    for text, complaint in (
        ("sigma_xi: 0.1", r"mine.yaml: unknown key 'sigma_xi'"),
        ("sigma_xy: -1", "mine.yaml: sigma_xy: .*greater than or equal to 0, got -1"),
        ("unvisited: 2", "mine.yaml: unvisited: .*less than or equal to 1, got 2"),
        ("blur: mean", "mine.yaml: blur: .*'add' or 'assign'"),
        ("max_tries: many", "mine.yaml: max_tries: .*integer"),
        ("[1, 2]", "mine.yaml: must hold keys"),
        ("a: [", "mine.yaml: not readable as YAML"),
    ):
        file.write_text(text)
        with pytest.raises(ValueError, match=complaint):
            load_params(file)
    file.write_text("sigma_xy: 3e-4\nmax_tries: 50")
    assert load_params(file, {"max_tries": "60"}).sigma_xy == 3e-4
    assert load_params(file, {"max_tries": "60"}).max_tries == 60

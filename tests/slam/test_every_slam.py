import math
from dataclasses import replace

import numpy as np
import pytest

from lidarnaut.benchmarks.drives.recording import make_setup, record_drive
from lidarnaut.benchmarks.drives.slams import measure_drive
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.robots import OdometryNoise, load_robot
from lidarnaut.envs.simulation import Reading
from lidarnaut.envs.slam import PRESETS, SLAM_NAMES, MatcherTrace, load_params, make_slam
from lidarnaut.envs.tasks.explore import Explore, ExploreTeam
from lidarnaut.envs.worlds import load_world
from tests.slam.rooms import BY_WHEELS, CIRCLE, CORRIDOR, LIDAR, ROOM, STAY, WHEELS, drive, follow, make_small, see

NO_RETURN = Reading.of_scan(np.full(LIDAR.num_beams, np.nan, dtype=np.float32))


@pytest.mark.parametrize(
    ("slam", "off"),
    [
        (make_small("tinyslam", "every_scan", noise=None), 0.06),
        (make_small("tinyslam"), 0.06),
        (make_small("hector"), 0.03),
        (make_small("hector", "intel"), 0.03),
        (make_small("gmapping"), 0.05),
        (make_small("gmapping", "intel"), 0.05),
        (make_small("gmapping", num_particles=1), 0.1),
    ],
)
def test_odometry_that_errs_is_corrected(slam, off):
    truth, estimated = drive(slam, CIRCLE, BY_WHEELS)
    assert math.dist(truth[:2], estimated[:2]) < off
    assert abs(estimated.theta - truth.theta) < 0.03
    assert not slam.belief.is_lost


def test_without_odometry_every_scan_is_matched_to_the_last_pose():
    truth, estimated = drive(make_small("hector", "faithful"), CIRCLE, [Pose2D(9.0, 9.0, 1.0)] * 400)
    np.testing.assert_allclose(estimated, truth, atol=0.03)


def test_beams_on_people_are_mapped_but_not_matched(monkeypatch):
    slam, other, matched = make_slam("truth", LIDAR), make_slam("truth", LIDAR), []
    monkeypatch.setattr(slam, "match", lambda ranges, pose: matched.append(ranges) or (pose, slam.params.quality))
    slam.unmatched, reading = np.arange(LIDAR.num_beams) < 90, see(STAY)
    grid = slam.update(reading, STAY).grid
    np.testing.assert_array_equal(matched[0], np.where(slam.unmatched, np.nan, reading.ranges))
    np.testing.assert_array_equal(grid.data, other.update(reading, STAY).grid.data)


FIRM = OdometryNoise(0.001, 0.005, 0.001, 0.001, 0.001)


@pytest.mark.parametrize("name", ["tinyslam", "hector", "graph", "gmapping"])
def test_wheels_that_spin_in_contact_do_not_move_the_pose(name):
    def push(*, bumper):
        slam, rng = make_slam(name, LIDAR, odometry_noise=FIRM), np.random.default_rng(0)
        slam.update(see(STAY, rng), STAY)
        for _ in range(100):
            slam.update(see(STAY, rng)._replace(bumper=bumper), Pose2D(0.02, 0.0, 0.0))
        return slam.belief.pose.x

    assert abs(push(bumper=True)) < 0.25  # odometry since the last key scan
    assert push(bumper=False) > 0.9


@pytest.mark.parametrize(
    ("name", "limit"),
    [("hector", 0.5), ("graph", 0.5), ("gmapping", 0.5), ("tinyslam?preset=every_scan,sigma_xy=0.05", 0.95)],
)
def test_observers_of_every_matcher_see_tested_poses_and_the_result(name, limit):
    heard, trace, moved, odometry = [], MatcherTrace(), Pose2D(0.3, 0.02, 0.02), Pose2D(0.32, 0.0, 0.0)
    watched, unwatched = make_slam(name, LIDAR, odometry_noise=WHEELS), make_slam(name, LIDAR, odometry_noise=WHEELS)
    watched.observers = (lambda *said: heard.append(said), trace)
    for slam in (unwatched, watched):
        slam.reset(np.random.default_rng(1))
        slam.update(see(STAY), STAY)
        slam.update(see(moved), odometry)
        heard.clear()
        slam.update(see(moved.compose(moved)), odometry)
    assert watched.belief.pose == unwatched.belief.pose
    np.testing.assert_array_equal(watched.belief.covariance, unwatched.belief.covariance)
    ((predicted, tested, (result, cost)),) = heard
    np.testing.assert_allclose(predicted, moved.compose(odometry), atol=0.03)
    assert len({pose for pose, _ in tested}) >= 3
    assert trace.tested == [(*pose, cost) for pose, cost in tested]
    np.testing.assert_allclose(result, watched.belief.pose, atol=1e-9)
    assert cost < limit * LIDAR.num_beams
    assert (result, cost) in tested
    if name.startswith("tinyslam"):
        assert cost == min(cost for _, cost in tested)


def test_kernels_report_the_odometry_in_contact_to_the_slam():
    def slips(physics):
        env = LidarEnv(Explore, world="turtlebot3_stage_1", robot="turtlebot3_burger", physics=physics, slam="tinyslam")
        env.reset(seed=0, options={"start": (1.7, 0.0, 0.0)})
        slam, found = env.robots[0].estimator, []
        match = slam.match
        slam.match = lambda *scan: (found.append(slam.slip), match(*scan))[1]
        for _ in range(60):
            env.step(np.array([1.0, 0.0], dtype=np.float32))
        assert env.robots[0].bumper
        assert env.unwrapped.rows.numbers["slip"][0] < 0.23
        env.close()
        return found

    for physics in ("bullet", "kinematic"):
        assert max(slips(physics)) == pytest.approx(0.2, abs=0.03)


NAMES = ("hector", "hector?preset=faithful", "graph", "gmapping?num_particles=3", "tinyslam")
WALLS = (CORRIDOR, [(50.0, -1.0, 50.0, 1.0)], ROOM)
"""A corridor, an empty hall and a room."""


@pytest.mark.parametrize(
    ("name", "walls", "num_beams"),
    [(name, WALLS[k], (1, 2, 180)[(k + shift) % 3]) for shift, name in enumerate(NAMES) for k in range(3)],
)
def test_unobservable_directions_keep_the_covariance_positive(name, walls, num_beams):
    lidar, pose, rng = replace(LIDAR, num_beams=num_beams), STAY, np.random.default_rng(3)
    slam = make_slam(name, lidar, 0.1, odometry_noise=OdometryNoise(heading_per_radian=0.3))
    slam.reset(np.random.default_rng(4))
    for motion in [Pose2D(0.05, 0.0, 0.12)] * 300:
        pose = pose.compose(motion)
        belief = slam.update(see(pose, rng, 0.03, walls=walls, lidar=lidar), motion)
        assert np.isfinite([*belief.pose, *belief.covariance.flat]).all()
        np.testing.assert_allclose(belief.covariance, belief.covariance.T, rtol=1e-9)
        assert np.linalg.eigvalsh(belief.covariance)[0] >= -1e-9 * np.trace(belief.covariance)


@pytest.mark.parametrize(("name", "off"), [("tinyslam", 0.02), ("hector", 0.0)])
def test_a_robot_that_stands_still_does_not_drift(name, off):
    _, after_a_minute = drive(make_small(name), [STAY] * 600, [STAY] * 600)
    np.testing.assert_allclose(after_a_minute, STAY, atol=off)


@pytest.mark.parametrize("name", ["tinyslam", "hector", "gmapping"])
def test_same_seed_same_bytes(name):
    def run(slam, seed):
        slam.reset(np.random.default_rng(seed))
        poses = [belief.pose for _, belief in follow(slam, CIRCLE[:150], np.random.default_rng(7))]
        return np.array(poses).tobytes() + slam.belief.grid.data.tobytes()

    slam = make_small(name)
    first = run(slam, 1)
    assert run(slam, 1) == run(make_small(name), 1) == first
    assert (run(slam, 2) == first) == (name == "hector")


@pytest.mark.parametrize(
    ("slam", "motions", "shape"),
    [
        (make_small("hector"), [Pose2D(0.02, 0.0, 0.0)] * 200, 5.0),
        (make_small("gmapping", num_particles=30), [Pose2D(0.1, 0.0, 0.0)] * 60, 2.0),
    ],
)
def test_covariance_is_long_along_a_corridor_and_small_in_a_room(slam, motions, shape):
    drive(slam, motions, motions, walls=CORRIDOR)
    along, across = np.sqrt(np.diag(slam.belief.covariance)[:2])
    assert along > max(shape * across, 0.02)
    drive(slam, motions[: len(motions) // 3], motions)
    assert 0.0 < np.sqrt(np.diag(slam.belief.covariance)[:2]).max() < 0.5 * along
    np.testing.assert_array_equal(slam.belief.covariance, slam.belief.covariance.T)


@pytest.mark.parametrize("name", ["tinyslam", "hector", "graph", "gmapping"])
def test_without_returns_the_pose_follows_odometry_until_the_robot_is_lost(name):
    is_limited = name in ("hector", "gmapping")
    slam = make_small(name, max_position_std=0.15) if is_limited else make_slam(name, LIDAR)
    slam.update(see(STAY), STAY)
    for _ in range(1, 60):
        before = slam.belief.pose
        belief = slam.update(NO_RETURN, Pose2D(0.4, 0.0, 0.2))
        np.testing.assert_allclose(belief.pose, before.compose(Pose2D(0.4, 0.0, 0.2)), atol=1e-9)
        is_uncertain = np.linalg.eigvalsh(belief.covariance[:2, :2])[-1] > 0.15**2
        assert not is_limited or belief.is_lost == is_uncertain
    assert belief.is_lost or not is_limited


@pytest.mark.parametrize("physics", ["kinematic", "bullet"])
def test_a_minute_in_turtlebot3_world(physics):
    robot = load_robot("turtlebot3_burger")
    setup = make_setup(load_world("turtlebot3_world"), robot, physics)
    drive = record_drive(setup, 11, 90.0)
    assert np.hypot(*np.diff(drive.truth[:, :2], axis=0).T).sum() > 10.0
    found, _ = measure_drive(setup, drive, make_slam("tinyslam", robot.lidar), 11)
    assert found["translation_m"] < 0.05
    assert found["rotation_deg"] < 1.5
    assert found["map_iou"] > 0.9


@pytest.mark.parametrize(("slam", "name"), [(slam, name) for slam in PRESETS for name in PRESETS[slam]])
def test_presets_map_the_room(slam, name):
    params = load_params(name, {"map_width": 10.0, "map_height": 10.0}, slam)
    estimator = make_slam(slam, LIDAR, params.resolution, params, WHEELS)
    assert estimator.params.odometry_noise == WHEELS
    for _ in range(3):
        estimator.update(see(STAY), STAY)
    assert math.hypot(*estimator.belief.pose[:2]) < (0.3 if slam == "tinyslam" else 0.05)
    assert (estimator.belief.grid.data >= 0).mean() > 0.1


@pytest.mark.parametrize("name", SLAM_NAMES)
def test_bad_readings_are_named(name):
    slam = make_slam(name, LIDAR)
    with pytest.raises(ValueError, match=r"shape \(180,\).*\(3,\)"):
        slam.update(Reading.of_scan(np.ones(3, dtype=np.float32)), STAY)
    with pytest.raises(ValueError, match="motion must be finite"):
        slam.update(see(STAY), Pose2D(0.0, math.nan, 0.0))


@pytest.mark.parametrize(
    ("name", "complaint"), [("gmapping", "GMapping cannot continue"), ("graph", "GraphSlam cannot continue")]
)
def test_no_map_can_be_given_and_teams_are_refused(name, complaint):
    slam = make_slam(name, LIDAR)
    with pytest.raises(ValueError, match=complaint):
        slam.reset(np.random.default_rng(0), STAY, slam.map)
    with pytest.raises(ValueError, match="cannot share a map"):
        LidarEnv(ExploreTeam, world="rooms", physics="kinematic", slam=name, num_robots=2)


@pytest.mark.parametrize(
    ("slam", "changes", "complaint"),
    [
        ("tinyslam", {"resolution": -1}, r"resolution: .*greater than 0, got -1"),
        ("hector", {"num_levels": 9}, "num_levels: .*less than or equal to 6, got 9"),
        ("hector", {"empty_prob": 0.5}, "empty_prob: .*less than 0.5, got 0.5"),
        ("hector", {"odometry_noise": {"position_std": 0.0}}, "position_std: Input should be greater than 0"),
        ("gmapping", {"num_particles": 0}, "num_particles"),
        ("gmapping", {"resample_below": 1.5}, "resample_below"),
        ("graph", {"urgent_correction": math.nan}, "urgent_correction"),
        ("graph", {"loops": {"min_score": 1.2}}, "min_score"),
    ],
)
def test_bad_params_are_named(slam, changes, complaint):
    with pytest.raises(ValueError, match=complaint):
        load_params("default", changes, slam)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("sigma_xy: -1", "mine.yaml: sigma_xy: .*greater than or equal to 0, got -1"),
        ("blur: mean", "mine.yaml: blur: .*'add' or 'assign'"),
        ("max_tries: many", "mine.yaml: max_tries: .*integer"),
        ("a: [", "mine.yaml: not readable as YAML"),
    ],
)
def test_bad_files_are_named(tmp_path, text, complaint):
    with pytest.raises(FileNotFoundError, match=r"missing\.yaml"):
        load_params(tmp_path / "missing.yaml")
    (tmp_path / "mine.yaml").write_text(text)
    with pytest.raises(ValueError, match=complaint):
        load_params(tmp_path / "mine.yaml")


def test_a_file_and_changes_are_joined(tmp_path):
    (tmp_path / "mine.yaml").write_text("sigma_xy: 3e-4\nmax_tries: 50")
    params = load_params(tmp_path / "mine.yaml", {"max_tries": "60"})
    assert (params.sigma_xy, params.max_tries) == (3e-4, 60)

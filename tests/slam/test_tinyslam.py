import dataclasses
import math
from types import SimpleNamespace

import numpy as np

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.robots import OdometryNoise
from lidarnaut.envs.simulation import Reading
from lidarnaut.envs.slam import MatcherTrace, TinySlam, load_params, make_slam

from .rooms import LIDAR, STAY, see


def test_firm_odometry_is_not_corrected():
    firm = OdometryNoise(1e-5, 0.0, 1e-5, 0.0, 0.0)
    slam = make_slam("tinyslam", LIDAR, odometry_noise=firm)
    slam.update(see(STAY), STAY)
    slam.update(see(Pose2D(0.25, 0.02, 0.0)), Pose2D(0.22, 0.0, 0.0))
    np.testing.assert_allclose(slam.belief.pose, (0.22, 0.0, 0.0), atol=1e-3)


def test_belief_is_updated_in_place_and_names_new_cells():
    slam = make_slam("tinyslam", LIDAR)
    belief = slam.reset(np.random.default_rng(0))
    assert (belief.grid.data == -1).all()
    assert len(belief.update.new_cells) == 0
    known = np.zeros(belief.grid.data.shape, dtype=bool)
    for k in range(5):
        assert slam.update(see(Pose2D(0.3 * k, 0.0, 0.0)), Pose2D(0.3, 0.0, 0.0) if k else STAY) is belief
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
        slam.update(see(Pose2D(0.1 * min(k, 4), 0.0, 0.06 * max(k - 4, 0))), motion)
        integrated.append(not np.array_equal(before, slam.belief.grid.data))
        assert integrated[-1] or len(slam.belief.update.new_cells) == 0
    assert integrated == [True, False, False, True, False, False, True, False]


def test_frames_of_odometry():
    # The estimated heading differs from odometry by 90 degrees: forward by the wheels is "along x" or "along y".
    nothing = Reading.of_scan(np.full(180, np.nan, dtype=np.float32))
    for frame, expected in (("robot_frame", (0.0, 1.0)), ("odometry_frame", (1.0, 0.0))):
        slam = TinySlam(LIDAR, load_params("default", {"odometry": frame}))
        slam.belief.pose = Pose2D(0.0, 0.0, math.pi / 2)
        slam.update(nothing, Pose2D(1.0, 0.0, 0.0))
        np.testing.assert_allclose(slam.belief.pose, (*expected, math.pi / 2), atol=1e-12)


def test_observers_see_the_search_and_change_nothing():
    params = load_params("every_scan", {"sigma_xy": 0.05, "sigma_theta": 0.03, "max_failed": 30, "max_tries": 90})
    heard = []
    events = ("on_matching_start", "on_scan_test", "on_pose_update", "on_matching_end")
    witness = SimpleNamespace(**{name: lambda *said, name=name: heard.append((name, *said)) for name in events})
    trace = MatcherTrace()
    watched, unwatched = TinySlam(LIDAR, params, [witness, trace]), TinySlam(LIDAR, params)
    moved = Pose2D(0.15, 0.06, 0.05)
    for slam in (watched, unwatched):
        slam.reset(np.random.default_rng(1))
        slam.update(see(STAY), STAY)
        slam.update(see(moved), STAY)
    assert watched.belief.pose == unwatched.belief.pose
    assert heard[0] == (events[0], STAY)
    assert heard[1][:2] == (events[1], STAY)
    assert 32 <= sum(name == events[1] for name, *_ in heard) <= 91
    updates = [said for name, *said in heard if name == events[2]]
    assert len(updates) >= 2
    assert [cost for _, cost in updates] == sorted((cost for _, cost in updates), reverse=True)
    assert heard[-1] == (events[3], *updates[-1])
    assert heard[-1][1] == watched.belief.pose
    assert trace.tested == [(*said[0], said[1]) for name, *said in heard if name == events[1]]
    watched.update(see(moved), STAY)
    assert trace.tested[0][:3] == tuple(heard[-1][1])


def test_presets_hold_the_documented_numbers():
    report, upstream = load_params("robot_vacuum"), load_params("upstream")
    changed = {"hole_width": 0.05, "sigma_xy": 0.01, "sigma_theta": 0.02}
    assert report == dataclasses.replace(upstream, **changed)
    assert (upstream.hole_width, upstream.sigma_xy, upstream.sigma_theta) == (1.5, 0.2, 0.1)
    assert (upstream.max_failed, upstream.max_tries, upstream.resolution) == (20, 100, 0.1)
    assert (upstream.occupied_prob, upstream.empty_prob) == (0.95, 0.01)

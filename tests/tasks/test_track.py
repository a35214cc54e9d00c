import dataclasses
import math

import numpy as np
import pytest

from lidarnaut.baselines.episode import begin_episode, decide_with, run
from lidarnaut.baselines.reactive import RouteFollower
from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.localization.fusion import measure_heading, measure_wheels
from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.simulation.odometry import arc_motion
from lidarnaut.envs.tasks.route import Progress, Route, rectangle
from lidarnaut.envs.tasks.route_map import find_pivot, make_route_map
from lidarnaut.envs.tasks.track import Track
from lidarnaut.envs.worlds import load_world, rasterize, save_map
from tests.rollouts import rollout
from tests.test_contract import TASKS

QUICK = {**TASKS["Track"], "map_resolution": 0.05}
"""A short route between pillars; a robot without a compass."""
PATH = np.array([[4.1, 3.2], [10.1, 3.2]])
HALL = {"robot": "mpo_500", "control_hz": 17.0, "physics": "kinematic", "path": PATH, "map_resolution": 0.05}
"""Six metres of the first side of the rectangle, with the robot of the experiment."""
EXACT = {**HALL, "start_spread": (0.0, 0.0)}


def follow(env, seed=0, watch=None):
    tracker, infos = RouteFollower(), []
    start = begin_episode(env, tracker, seed, np.random.default_rng(0))
    run(env, decide_with(tracker, env), *start, watch or infos.append)
    return infos


@pytest.mark.parametrize("physics", ["bullet", "kinematic"])
def test_the_tracker_follows_the_route_to_its_end(physics):
    env = LidarEnv(Track, **{**EXACT, "physics": physics})
    infos = follow(env)
    assert infos[-1]["end_reason"] == "completed"
    assert infos[-1]["is_success"]
    assert infos[-1]["collisions"] == 0
    assert max(abs(info["deviation"]) for info in infos) < 0.05
    assert max(info["pose_error"][0] for info in infos) < 0.05
    assert max(info["pose_error"][1] for info in infos) < math.radians(0.7)
    assert sum(info["rewards"]["progress"] for info in infos) == pytest.approx(env.task.route.length, abs=0.15)
    assert infos[-1]["rewards"]["completed"] == Track.weights["completed"]
    counts = env.robots[0].estimator.ekf.counts
    assert counts["encoder"]["accepted"] == counts["compass"]["accepted"] == len(infos) - 1
    assert 40 < counts["map"]["accepted"] < 60
    env.close()


def test_an_initial_pose_error_is_corrected_and_no_measurement_is_rejected():
    env = LidarEnv(Track, **HALL)
    for seed in range(2):
        off = env.reset(seed=seed)[1]["pose_error"][1]
        for _ in range(10):
            info = env.step(np.zeros(2, dtype=np.float32))[4]
        assert info["pose_error"][1] < max(0.2 * off, math.radians(0.1))
        assert env.robots[0].estimator.ekf.counts["compass"] == {"accepted": 10}


def test_straying_ends_the_episode_and_two_readings_of_one_time_are_refused():
    env = LidarEnv(Track, **{**QUICK, "max_deviation": 0.2})
    *_, terminated, truncated, info = rollout(env, 0, 100, lambda _: np.array([1.0, 0.4], dtype=np.float32))[-1]
    assert (terminated, truncated, info["end_reason"]) == (True, False, "strayed")
    with pytest.raises(ValueError, match="time must increase"):
        env.robots[0].estimator.update(env.reading, Pose2D(0.0, 0.0, 0.0))


def test_the_default_route_is_a_rectangle_of_78_m_that_ends_where_it_starts():
    world = load_world("workshop_hall")
    route = Route.of(rectangle(world.spawns[0]))
    assert route.length == pytest.approx(78.0, abs=0.01)
    np.testing.assert_allclose(route.points[-1], route.points[0], atol=1e-9)
    assert np.ptp(route.points[:, 0]) == pytest.approx(24.0)
    assert abs(np.diff(np.unwrap(route.headings))).max() < 0.06
    assert np.unwrap(route.headings)[-1] == pytest.approx(2 * math.pi, abs=0.06)


def test_headings_of_a_route_are_its_tangents():
    route = Route.of(rectangle(Pose2D(0.0, 0.0, 0.0)))
    for turn in (0.3, 0.8, 1.3):
        # The first corner begins at x = 22.
        tangent = Pose2D(22.0 + math.sin(turn), 1.0 - math.cos(turn), turn)
        x, y, heading = tangent.between(route.at(22.0 + turn))
        assert math.hypot(x, y) < 0.002
        assert abs(heading) < 0.002
    assert route.at(-1.0) == pytest.approx(route.start, abs=1e-12)
    assert route.at(100.0)[:2] == pytest.approx((0.0, 0.0), abs=1e-9)
    corner = Route.of([[0.0, 0.0], [-1.0, 0.0], [-1.0, -1.0]])
    assert abs(corner.at(0.9).theta) == pytest.approx(math.pi, abs=1e-6)
    assert corner.at(1.0).theta == pytest.approx(-0.75 * math.pi, abs=1e-6)


def test_progress_does_not_leap_to_where_the_route_comes_by_again():
    route = Route.of(rectangle(Pose2D(0.0, 0.0, 0.0)))
    progress = Progress(route)
    assert progress.update(Pose2D(0.0, 0.02, 0.0)) == pytest.approx((0.0, 0.02), abs=1e-9)
    for x, y in route.points[::20]:
        along, left = progress.update(Pose2D(x, y, 0.0))
    assert along == pytest.approx(78.0, abs=1.0)
    assert left == pytest.approx(0.0, abs=1e-6)
    assert progress.update(Pose2D(3.0, 3.0, 0.0))[0] >= along


def test_maps_are_made_once_and_are_aligned_with_the_world():
    route = Route.of(HALL["path"])
    world, robot = load_world("workshop_hall"), load_robot("mpo_500")
    arguments = (world, robot, "kinematic", "tinyslam?sigma_xy=0.01", route.points.tobytes(), 0.05, 1 / 17, 3)
    made = make_route_map(*arguments)
    assert make_route_map(*arguments) is made
    assert abs(made.north) < math.radians(0.1)
    assert made.poses[-1] == pytest.approx((5.8, 0.0, 0.0), abs=0.15)
    assert np.diff(made.poses[:, 0]).min() > 0.15
    assert made.grid.data[tuple(made.grid.cells(np.array([0.0, 0.0])))] == 0
    # The south wall is at world y 0, which is -3.2 as seen from the start.
    column = made.grid.cells(np.array([0.5, 0.0]))[1]
    rows = np.flatnonzero(made.grid.data[:, column] >= 65)
    wall = made.grid.centers(np.array([rows.min(), column]))[1]
    assert wall == pytest.approx(-3.2, abs=0.06)


def roll(pivot, turns):
    """Return base poses and wheel motions of steps of 0.2 m; the point `pivot` ahead of the axle has no sideslip."""
    wheels = [Pose2D(*arc_motion(0.2, turn)) for turn in turns]
    ahead, poses = Pose2D(pivot, 0.0, 0.0), [Pose2D(1.0, 2.0, 3.0)]
    for motion in wheels:
        poses.append(poses[-1].compose(ahead).compose(motion).compose(ahead.inverse()))
    return np.array(poses), np.array(wheels)


@pytest.mark.parametrize("pivot", [0.03, -0.01, 0.0])
def test_the_pivot_is_found_from_sideslip_in_turns(pivot):
    rng = np.random.default_rng(0)
    poses, wheels = roll(pivot, [*np.zeros(20), *np.full(40, 0.15), *np.zeros(20), *np.full(20, -0.1)])
    assert find_pivot(poses, wheels) == pytest.approx(pivot, rel=0.05)
    assert find_pivot(poses + 0.001 * rng.standard_normal(poses.shape), wheels) == pytest.approx(pivot, abs=0.003)
    # Without turns it stays at the axle.
    poses, wheels = roll(pivot, np.zeros(50))
    assert abs(find_pivot(poses + 0.001 * rng.standard_normal(poses.shape), wheels)) < 0.001
    assert find_pivot(poses[:1], wheels[:0]) == 0.0


def test_estimates_are_poses_of_the_base_which_slips_sideways():
    env = LidarEnv(Track, **EXACT, fusion="encoder", map=rasterize(load_world("workshop_hall"), 0.05))
    estimator, pivot = env.robots[0].estimator, Pose2D(0.1, 0.0, 0.0)
    estimator.pivot = pivot
    env.reset(seed=0)
    start = env.belief.pose.compose(pivot)
    for _ in range(20):
        env.step(np.array([0.0, 0.3], dtype=np.float32))
        pose = estimator.estimate.pose
        assert tuple(pose.compose(pivot)[:2]) == pytest.approx(start[:2], abs=2e-3)
    assert pose.theta - start.theta > 0.1


def test_a_route_through_a_wall_is_no_route():
    path = [[-2.0, -0.5], [-1.4, -0.5], [-1.4, 2.2], [-2.0, 4.0]]
    with pytest.raises(RuntimeError, match=r"did not reach the end of the route in world 'turtlebot3_world'"):
        LidarEnv(Track, **{**QUICK, "path": path}).reset(seed=0)


def test_encoders_measure_the_mean_of_a_period_for_its_beginning():
    robot = load_robot("mpo_500")
    measurement = measure_wheels(robot, 1.2, 1.2 - 1.0, (50, 60))
    tick = 2 * math.pi * 0.127 / 500
    assert measurement.time == pytest.approx(1.0)
    np.testing.assert_allclose(measurement.values, [55 * tick / 0.2, 10 * tick / 0.548 / 0.2])
    assert np.linalg.eigvalsh(measurement.covariance)[0] > 0
    rng = np.random.default_rng(0)
    # Samples of two uniform roundings per wheel, plus slip, have the stated covariance.
    draws = tick * (rng.random((100_000, 2)) - rng.random((100_000, 2)))
    draws += rng.normal(size=(100_000, 2)) * robot.drive.slip_std * np.sqrt(np.array([50, 60]) * tick)
    values = np.column_stack([draws.mean(axis=1), (draws[:, 1] - draws[:, 0]) / 0.548]) / 0.2
    np.testing.assert_allclose(np.cov(values.T), measurement.covariance, rtol=0.03, atol=2e-5)


def test_the_compass_tells_headings_in_the_map_frame():
    robot = load_robot("mpo_500")
    first = measure_heading(robot, 0.1, 0.1, math.nan, 3.1)
    second = measure_heading(robot, 0.2, 0.1, 3.1, 3.2 - 2 * math.pi)
    assert first.values == pytest.approx([3.1, 0.0])
    assert second.values == pytest.approx([3.2 - 2 * math.pi, 1.0])
    assert first.covariance[1, 1] > second.covariance[1, 1]
    assert second.covariance[0, 0] == pytest.approx(4 * math.radians(0.1) ** 2 / 12, rel=0.1)
    assert np.isnan(measure_heading(robot, 0.3, 0.1, 3.1, math.nan).values).all()


def test_a_map_of_ones_own_replaces_the_mapping_drive(tmp_path, monkeypatch):
    world = load_world("workshop_hall")
    walls, path = rasterize(world, 0.05), tmp_path / "hall.yaml"
    save_map(walls, path)
    monkeypatch.setattr("lidarnaut.envs.tasks.track.make_route_map", None)
    arguments = {**EXACT, "map_resolution": 0.3}
    infos = follow(LidarEnv(Track, **arguments, map=path))
    assert infos[-1]["end_reason"] == "completed"
    assert max(info["pose_error"][0] for info in infos) < 0.08
    moved = dataclasses.replace(walls, origin=tuple(np.subtract(walls.origin, (10.0, 5.0)).tolist()))
    shifted = follow(LidarEnv(Track, **arguments, map=moved, map_pose=(10.0, 5.0, 0.0)))
    assert shifted[-1]["end_reason"] == "completed"
    assert max(info["pose_error"][0] for info in shifted) < 0.08
    with pytest.raises(ValueError, match="map_pose must be"):
        LidarEnv(Track, **arguments, map=moved, map_pose=(1.0, 2.0))


def test_fusion_is_not_worse_with_a_noisy_and_disturbed_compass():
    robot = load_robot("mpo_500")
    imu = dataclasses.replace(robot.imu, compass_std=math.radians(1.15), compass_deviation=0.1)
    magnets = np.array([[7.0, 2.0, 0.3, 2.0]])
    noisy = {**EXACT, "robot": dataclasses.replace(robot, imu=imu), "map_resolution": 0.02}
    noisy["world"] = dataclasses.replace(load_world("workshop_hall"), magnets=magnets)
    errors = {}
    for fusion in ("full", "amcl", "encoder_compass"):
        infos = follow(LidarEnv(Track, **noisy, fusion=fusion))
        errors[fusion] = np.sqrt(np.mean([info["pose_error"][0] ** 2 for info in infos]))
    assert errors["full"] < 0.01
    assert errors["full"] < 1.1 * min(errors.values())


@pytest.mark.parametrize("control_hz", [1.0, 5.0])
def test_the_fusion_is_as_good_as_amcl_at_low_control_rates(control_hz):
    env = LidarEnv(Track, **{**EXACT, "control_hz": control_hz})
    errors = []

    def watch(info):
        truth, fused = env.map_pose.between(env.truths[0].state.pose), env.robots[0].estimator
        errors.append([truth.between(pose) for pose in (fused.estimate.pose, fused.localized.pose)])

    follow(env, watch=watch)
    full, amcl = np.sqrt(np.mean(np.square(errors), axis=0))
    assert np.hypot(*full[:2]) < 1.15 * np.hypot(*amcl[:2])
    assert full[2] < amcl[2] + math.radians(0.05)
    # Also the first: the robot starts at full acceleration.
    assert set(env.robots[0].estimator.ekf.counts["encoder"]) == {"accepted"}

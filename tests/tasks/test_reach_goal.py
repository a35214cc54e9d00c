import math
from dataclasses import replace

import numpy as np
import pytest

from lidarnaut.envs.core import LidarEnv
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.geometry.clearance import clearance
from lidarnaut.envs.measures import REACH, EpisodeHistory, barn_metric
from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.tasks.goals import GeodesicDistance
from lidarnaut.envs.tasks.reach_goal import ReachGoal
from lidarnaut.envs.worlds import FixedRoute
from tests.rollouts import rollout
from tests.rooms import make_room

QUICK = {"world": "turtlebot3_world", "physics": "kinematic", "slam": "truth"}
STOP, AHEAD = np.zeros(2, dtype=np.float32), np.array([1.0, 0.0], dtype=np.float32)
TO_WALL = {**QUICK, "start": (-2.0, -0.5, -math.pi / 2)}
TO_GOAL = {**QUICK, "start": (-2.0, -0.5, 0.0), "goal": (1.4, 0.0, 0.0)}


def drive(env, action, steps):
    return rollout(env, 0, steps, lambda _: action)[1:]


@pytest.mark.parametrize(("given", "seen"), [("pose", [0.15, 0.0, -1.0, 0.4]), ("bearing", [0.0, -1.0])])
def test_the_goal_is_told_in_the_frame_of_the_pose_estimate(given, seen):
    ends = {"start": (-2.0, -0.5, math.pi / 2), "goal": (0.0, -1.5)}
    observation, info = LidarEnv(ReachGoal, **QUICK, **ends, goal_given=given).reset(seed=0)
    assert info["distance_to_goal"] == pytest.approx(1.5)
    np.testing.assert_allclose(observation["goal"], seen, atol=1e-6)


def test_a_goal_given_by_its_bearing_has_no_heading():
    for arguments in ({"goal": (0.0, -1.5, 0.0)}, {"heading_tolerance": 0.3}):
        with pytest.raises(ValueError, match="goal_given='bearing' does not give headings"):
            LidarEnv(ReachGoal, **QUICK, goal_given="bearing", **arguments)


def test_the_pose_comes_from_odometry_or_truth_without_a_map_or_from_a_slam_with_one():
    errors, sizes = {}, {}
    for slam in ("odometry", "truth", "hector"):
        env = LidarEnv(ReachGoal, **{**QUICK, "slam": slam, "contact": "costs"})
        errors[slam], sizes[slam] = rollout(env, 2, 100)[-1][4]["pose_error"][0], env.belief.grid.data.size
        assert env.belief.pose == env.robots[0].predicted_pose
    assert errors["truth"] < 1e-9 < 1e-4 < errors["odometry"] < 0.2
    assert sizes["odometry"] == sizes["truth"] == 1 < sizes["hector"]


def test_contact_ends_the_episode_or_costs():
    *_, (_, reward, terminated, _, info) = drive(LidarEnv(ReachGoal, **TO_WALL), AHEAD, 100)
    assert terminated
    assert (info["end_reason"], info["is_success"], info["rewards"]["collision"]) == ("wall", False, -20.0)
    assert info["rewards"]["clearance"] == pytest.approx(-0.04, abs=0.001)
    assert reward == pytest.approx(sum(info["rewards"].values()))
    out = drive(LidarEnv(ReachGoal, **TO_WALL, contact="costs"), AHEAD, 100)
    assert len(out) == 100
    assert out[-1][4]["rewards"]["collision"] == pytest.approx(-2.0)


def test_nearness_to_obstacles_costs_by_the_gap_to_the_footprint():
    env = LidarEnv(ReachGoal, **TO_WALL, contact="costs")
    env.reset(seed=0)
    paid = 0
    for _ in range(60):
        *_, info = env.step(AHEAD)
        (x, y, _), _ = env.simulator.states[0]
        share = 1.0 - (clearance(x, y, env.world.segments, env.world.circles) - env.robot_params.radius) / 0.15
        assert info["rewards"]["clearance"] == pytest.approx(-0.04 * min(max(share, 0.0), 1.0))
        paid += 0.0 < share < 1.0
    assert paid > 3


def test_geodesic_distances_are_those_of_navigation_to_a_cell():
    env = LidarEnv(ReachGoal, **{**QUICK, "world": "turtlebot3_house"}, min_distance=8.0)
    lengths = []
    for seed in range(5):
        _, info = env.reset(seed=seed)
        exact = GeodesicDistance(env.task.area, env.map_pose.compose(env.task.goal)).length(env.map_pose)
        lengths.append(info["geodesic_distance"])
        assert lengths[-1] == pytest.approx(exact, abs=0.5)
        assert info["distance_to_goal"] >= 8.0
    assert max(lengths) > 12.0


def test_progress_is_smooth_and_sums_up():
    out = drive(LidarEnv(ReachGoal, **TO_GOAL), AHEAD, 100)
    progress = [step[4]["rewards"]["progress"] for step in out]
    assert np.min(progress[5:]) > 0.01
    assert np.max(progress) < 0.03
    assert out[-1][4]["end_reason"] == "reached"
    assert out[-1][4]["progress"] == 1.0


def test_jerk_is_that_of_the_speed_that_the_controller_reaches():
    robot = replace(load_robot("turtlebot3_burger"), max_acc_v=1.0)
    env = LidarEnv(ReachGoal, **TO_GOAL, robot=robot, time_limit=0.5)
    # 0.1 m/s after 0.1 s, 0.2 after 0.2, then 0.22: accelerations 1, 1, 0.2, 0, 0, which change by 2 in 0.5 s.
    assert drive(env, AHEAD, 10)[-1][4]["jerk"] == pytest.approx(2.0 / 0.5)


def test_measures_weigh_success_by_path_time_and_the_metric_of_barn():
    samples = {"geodesic_distance": np.array([8.0, 0.2]), "path_length": np.array([0.0, 10.0])}
    final = {"is_success": True, "path_length": 10.0, "time": 16.0, "geodesic_distance": 0.2}
    history = EpisodeHistory(samples, final | {"jerk": 1.0, "barn_metric": 0.5}, 100.0, 2.0)
    values = {measure.name: measure.compute(history) for measure in REACH}
    assert (values["sct"], values["spl"], values["time_to_goal"]) == (0.25, 0.8, 16.0)
    failed = EpisodeHistory(samples, history.final | {"is_success": False}, 100.0, 2.0)
    assert [measure.compute(failed) for measure in REACH][:3] == [0.0, 0.0, math.inf]
    assert barn_metric(True, 6.0, 5.0) == 0.5
    assert barn_metric(True, 20.0, 5.0) == 0.25
    assert barn_metric(True, 90.0, 5.0) == 0.125
    assert barn_metric(False, 6.0, 5.0) == 0.0


def test_the_clock_of_barn_starts_when_the_robot_moves():
    env = LidarEnv(ReachGoal, **TO_GOAL)
    _, info = env.reset(seed=0)
    ideal = info["geodesic_distance"] / env.robot_params.max_v
    for _ in range(150):
        env.step(STOP)
    while not any(env.is_over):
        *_, info = env.step(AHEAD)
    assert info["time"] > 2.0 * ideal
    assert info["barn_metric"] == 0.5


def test_a_world_may_have_a_goal_of_its_own_and_a_length_that_its_benchmark_counts():
    env = LidarEnv(ReachGoal, world="barn:12", physics="kinematic", start="spawn", goal="world", goal_tolerance=1.0)
    _, info = env.reset(seed=0)
    assert (env.robot_params.name, env.time_limit, info["distance_to_goal"]) == ("jackal", 100.0, pytest.approx(10.0))
    assert env.map_pose.compose(env.task.goal)[:2] == pytest.approx(env.world.goals[0][:2])
    assert info["geodesic_distance"] == pytest.approx(env.world.optimal_length, rel=0.2)
    with pytest.raises(ValueError, match="world 'turtlebot3_world' has no goals"):
        LidarEnv(ReachGoal, **QUICK, goal="world").reset(seed=0)


def box(points, speed):
    """Return a square of 12 m in which a person walks between two points."""
    person = FixedRoute(0.3, np.array(points), speed)
    return make_room(0.0, 0.0, 12.0, 12.0, people=[person], spawn=Pose2D(2.0, 6.0, 0.0))


@pytest.mark.parametrize("physics", ["kinematic", "bullet"])
@pytest.mark.parametrize(
    ("route", "action", "robot_drove"),
    [
        ([((6.0, 6.0), (2.0, 6.0)), 1.0], STOP, False),
        ([((2.8, 6.0), (2.8, 6.01)), 0.001], AHEAD, True),
        ([((6.0, 6.0), (2.0, 6.0)), 1.0], 0.5 * AHEAD, False),
    ],
)
def test_contact_with_people_tells_by_whose_motion(route, action, robot_drove, physics):
    settings = {"world": box(*route), "physics": physics, "start": "spawn", "goal": (8.0, 2.0, 0.0)}
    env = LidarEnv(ReachGoal, **settings, robot="turtlebot3_waffle_pi")
    *_, (_, _, terminated, _, info) = drive(env, action, 100)
    assert terminated
    assert (info["end_reason"], info["at_fault"]) == ("person", robot_drove)
    assert (info["hit_wall"], info["hit_person"], info["hit_by_person"]) == (0, robot_drove, not robot_drove)
    assert info["least_gap"] < 0.03
    assert info["rewards"]["people"] == pytest.approx(-0.06, abs=0.005)
    assert info["rewards"]["collision"] == -20.0


@pytest.mark.parametrize("physics", ["kinematic", "bullet"])
def test_who_runs_into_a_robot_that_drives_on_is_no_wall(physics):
    """At the end of the period the robot is 6 cm ahead again."""
    settings = {"world": box([(0.4, 6.0), (11.0, 6.0)], 1.5), "physics": physics, "start": "spawn"}
    env = LidarEnv(ReachGoal, **settings, goal=(8.0, 2.0, 0.0), robot="jackal")
    *_, (_, _, _, _, info) = drive(env, 0.3 * AHEAD, 100)
    assert (info["end_reason"], info["hit_by_person"]) == ("person", 1)
    assert env.simulator.people[0, 0] < env.simulator.states[0].pose.x - 0.3 - env.robot_params.radius - 0.04
    assert [(contact.kind, contact.by) for contact in env.simulator.contacts] == [("person", "other")]


def stand_by(points, speed, time):
    """Return the rewards and the last info of a robot of 0.22 m that stands in the box."""
    robot = replace(load_robot("turtlebot3_waffle_pi"), radius=0.22)
    settings = {"physics": "kinematic", "start": "spawn", "goal": (8.0, 2.0, 0.0), "time_limit": time, "robot": robot}
    out = drive(LidarEnv(ReachGoal, world=box(points, speed), **settings), STOP, 200)
    return [step[4]["rewards"]["people"] for step in out], out[-1][4]


def test_nearness_to_people_and_times_to_collision_are_measured():
    paid, info = stand_by([(8.0, 7.02), (0.5, 7.02)], 1.0, 7.0)  # passes 0.5 m from the robot
    assert (info["end_reason"], info["intrusion_time"]) == ("time_limit", 0.0)
    assert info["least_gap"] == pytest.approx(0.5, abs=0.01)
    assert min(paid) > -0.001
    _, info = stand_by([(4.0, 6.0), (3.0, 6.0)], 0.5, 2.0)  # walks at the robot, up to a gap of 0.48 m
    assert info["least_gap"] == pytest.approx(0.48)
    assert info["least_time_to_collision"] == pytest.approx(0.48 / 0.5)
    paid, info = stand_by([(2.9, 6.0), (4.9, 6.0)], 0.5, 1.0)  # walks away, from a gap of 0.38 m
    assert info["intrusion_time"] == pytest.approx(0.1)
    assert paid[0] == pytest.approx(-0.06 * (0.5 - 0.43) / 0.5)
    assert info["least_time_to_collision"] == 10.0

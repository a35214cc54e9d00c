import dataclasses
import math
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import lidarnaut  # noqa: F401
from lidarnaut import make_explorer
from lidarnaut.agents.policies import make_policy
from lidarnaut.baselines import policies_for
from lidarnaut.baselines.episode import begin_episode, decide_with
from lidarnaut.driver import Driver
from lidarnaut.driver.simulated_robot import SimulatedRobot
from lidarnaut.envs.geometry import wrap_angle
from lidarnaut.envs.logs.log import load_log
from lidarnaut.envs.logs.trajectory import between_poses, compose_poses, odometry_scales
from lidarnaut.envs.navigation import GoalNavigator, GoalParams
from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.worlds import load_world
from lidarnaut.envs.wrappers import BagRecorder

from .feeding import feed
from .loop import IDEAL, LINKS, Link, Loop

BURGER = "turtlebot3_burger"
STEPS = 120


def learned(name, **options):
    pytest.importorskip("torch")
    from lidarnaut.agents.learned import load_policy

    return load_policy(f"pretrained/{name}", **options)


def controller(name):
    env = gymnasium.make("lidarnaut/ReachGoal-v0", physics="kinematic")
    env.reset(seed=0)
    return policies_for(env)[name]()


EXPLORE = {"id": "lidarnaut/Explore-v0", "world": "turtlebot3_house", "robot": BURGER}
REACH = {"id": "lidarnaut/ReachHouse-v0", "robot": BURGER, "slam": "hector"}
NAVIGATE = {"id": "lidarnaut/Navigate-v0", "world": "turtlebot3_house", "robot": BURGER, "start": "spawn"}
NAVIGATE |= {"initial_pose": tuple(load_world("turtlebot3_house").spawns[0])}
CASES = {
    "pursuit": (lambda: make_explorer("pursuit"), EXPLORE | {"slam": "tinyslam"}),
    "rrt": (lambda: make_explorer("rrt"), EXPLORE),
    "score": (lambda: learned("frontiers", pursuit=True), EXPLORE),
    "mppi": (lambda: controller("mppi"), REACH),
    "dwb": (lambda: controller("dwb"), NAVIGATE | {"heading_tolerance": 0.2}),
    "amcl": (lambda: controller("pursuit"), NAVIGATE),
    "crowd": (lambda: learned("crowd"), {"id": "lidarnaut/ReachCrowd-v0"}),
    "reach": (lambda: learned("reach"), REACH),
}


def compare(make, arguments, motion):
    """Feed the readings of an episode to a driver; return both sequences of commands, and the driver."""
    policy, own = make(), make()
    arguments = {"physics": "kinematic", "track_people": True, **arguments}
    if hasattr(policy, "observations"):
        arguments |= {"observations": policy.observations, "collision_monitor": policy.collision_monitor}
    env = gymnasium.make(**arguments).unwrapped
    observation, _ = begin_episode(env, policy, 3, np.random.default_rng([3, 1]))
    decide = decide_with(policy, env)
    simulated = "world", "robot", "physics", "people", "start"
    kept = {key: value for key, value in arguments.items() if key not in simulated}
    if hasattr(env.task, "localizer"):
        kept["map"] = env.task.prior(0, np.random.default_rng(0)).map
    driver = Driver(own, env.robot_params, motion=motion, seed=3, **kept)
    if env.task.goal is not None:
        driver.goal(*env.task.goal[: 3 if "heading_tolerance" in kept else 2])
    commands = []
    for _ in range(STEPS):
        reading = env.reading
        if motion == "encoders":
            driver.encoders(*reading.ticks, reading.time)
            driver.imu(reading.yaw_rate, reading.time)
        else:
            driver.odometry(reading.odometry, reading.time)
        driver.bumper(reading.bumper)
        driver.scan(reading.ranges, reading.time)
        action = decide(observation)
        env.period.command(env.commands(action))
        commands.append((env.rows.numbers["command"][0].copy(), driver.command(reading.time)))
        observation, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            break
    return np.array(commands), driver


@pytest.mark.parametrize("name", CASES)
def test_a_driver_commands_as_the_environment_does(name):
    commands, driver = compare(*CASES[name], "encoders")
    assert len(commands) > 40
    np.testing.assert_array_equal(commands[:, 1], commands[:, 0])
    assert driver.reason == ""
    assert not driver.dropped


def test_a_driver_commands_as_the_environment_does_with_a_policy_in_onnx(tmp_path, monkeypatch):
    pytest.importorskip("onnxruntime")
    export = pytest.importorskip("lidarnaut.agents.export", exc_type=ImportError)
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "examples"))
    from run_onnx import OnnxPolicy

    export.main("ppo:pretrained/crowd", tmp_path / "crowd.onnx")

    def make():
        policy = make_policy(OnnxPolicy(tmp_path / "crowd.onnx"))
        policy.observations, policy.collision_monitor = ("trajectories", "goal", "motion", "limits"), True
        return policy

    commands, _ = compare(make, {"id": "lidarnaut/ReachCrowd-v0"}, "encoders")
    assert len(commands) > 40
    np.testing.assert_array_equal(commands[:, 1], commands[:, 0])


# A particle filter amplifies rounding by its draws, to about its own spread.
@pytest.mark.parametrize(("name", "bound"), [("rrt", 1e-3), ("amcl", 0.1), ("crowd", 1e-3)])
def test_poses_of_odometry_differ_by_rounding(name, bound):
    commands, _ = compare(*CASES[name], "odometry")
    assert np.quantile(np.abs(commands[:, 1] - commands[:, 0]), 0.9) < bound


def loop_with(driver, link=IDEAL):
    return Loop(driver, SimulatedRobot("turtlebot3_world", BURGER, start="spawn"), link)


@pytest.mark.parametrize("link", [*LINKS.values(), Link(odometry_delay=0.15)])
def test_scans_and_odometry_of_other_rates_and_delays_are_aligned(link):
    driver = Driver(make_explorer("pursuit"), BURGER)
    messages = loop_with(driver, link)
    messages.run(25.0)
    assert messages.contacts == 0
    assert messages.error < 0.06
    assert (driver.belief.grid.data >= 0).sum() > 6000
    assert not any(messages.reasons[5:])


def test_without_scans_or_odometry_or_with_late_ones_the_robot_stops_and_goes_on_later():
    driver = Driver(make_explorer("pursuit"), BURGER, timeout=0.5)
    messages = loop_with(driver)
    assert driver.command(0.0) == (0.0, 0.0)
    assert driver.reason == "no scan yet"
    messages.run(4.0)
    late = Link(odometry_delay=2.0, scan_delay=2.0)
    for silent, link, reason in (
        ({"scan"}, IDEAL, "no scan for 0.6 s"),
        ({"odometry"}, IDEAL, "no odometry for 0.6 s"),
        (set(), late, "no scan for 2."),
    ):
        messages.silent, messages.link = silent, link
        messages.run(4.0)
        assert any(each.startswith(reason) for each in messages.reasons)
        assert messages.command == (0.0, 0.0)
        messages.silent, messages.link = set(), IDEAL
        messages.run(6.0)
        assert messages.reasons[-1] == ""
        assert messages.command != (0.0, 0.0)
    assert messages.error < 0.06


@pytest.mark.parametrize("jump", [-5.0, 1000.0])
def test_a_jump_of_the_clock_begins_anew_and_keeps_the_map(jump):
    driver = Driver(make_explorer("pursuit"), BURGER)
    messages = loop_with(driver)
    messages.run(5.0)
    known = (driver.belief.grid.data >= 0).sum()
    messages.offset = jump
    messages.run(5.0)
    assert messages.reasons[-1] == ""
    assert messages.error < 0.06
    assert (driver.belief.grid.data >= 0).sum() >= known
    messages.offset, messages.silent = jump - 5.0, {"scan"}  # and no further scans
    messages.run(2.0)
    assert messages.command == (0.0, 0.0)
    assert messages.reasons[-1].startswith("no scan for ")
    messages.silent, messages.offset = {"scan", "odometry"}, -1000.0
    messages.run(1.0)
    assert messages.command == (0.0, 0.0)


def test_unusable_messages_are_dropped_and_counted():
    driver = Driver(make_explorer("pursuit"), BURGER)
    messages = loop_with(driver)
    messages.run(2.0)
    now = messages.robot.time - 0.02
    driver.scan(np.full(360, np.nan), now + 1.0)
    driver.scan(messages.robot.reading.ranges, 1.5)
    driver.odometry((math.nan, 0.0, 0.0), now + 1.0)
    driver.odometry((0.0, 0.0, 0.0), math.inf)
    driver.odometry((0.0, 0.0, 0.0), now)
    assert driver.dropped == {
        "scan without a valid beam": 1,
        "scan that is not newer than the last": 1,
        "odometry that is not finite": 2,
        "odometry that is not newer than the last": 1,
    }
    messages.run(2.0)
    assert messages.reasons[-1] == ""
    with pytest.raises(ValueError, match=r"scan must have 360 ranges, got shape \(3,\)"):
        driver.scan(np.ones(3), 9.0)


def test_a_jump_of_odometry_does_not_move_the_beams_of_a_scan():
    driver = Driver(make_explorer("pursuit"), BURGER, slam="odometry")
    for k in range(20):
        driver.odometry((40.0 if k >= 10 else 0.0, 0.0, 0.0), 0.1 * k)
        driver.scan(np.full(360, 1.0), 0.1 * k - 0.3, np.linspace(0.0, 0.25, 360))
        driver.command(0.1 * k)
        assert not driver.has_begun or (driver.env.reading.ranges == 1.0).all()
    assert driver.dropped["jump of odometry"] == 1


@pytest.mark.parametrize("first", [5, 2**31 - 1, -(10**12)])
def test_encoders_that_begin_anew_do_not_move_the_robot(first):
    """The base restarts at zero after 20 of 40 messages, each 2 cm further."""
    driver = Driver(make_explorer("pursuit"), BURGER, motion="encoders", slam="odometry")
    counts = round(0.02 / driver.robot.odometry.metres_per_tick)
    for k in range(40):
        count = first + k * counts if k < 20 else (k - 20) * counts
        driver.encoders(count, count, 0.1 * k)
        driver.scan(np.full(360, 1.0), 0.1 * k - 0.03)
        driver.command(0.1 * k)
    moved = counts * driver.robot.odometry.metres_per_tick
    assert driver.dropped == {"jump of encoders": 1}
    assert driver.belief.pose.x == pytest.approx(38 * moved, abs=1e-6)


def test_a_slow_robot_may_be_pushed_by_hand():
    robot = dataclasses.replace(load_robot(BURGER), max_v=0.1)
    driver = Driver(make_explorer("pursuit"), robot, slam="odometry")
    for k in range(41):
        feed(driver, 0.05 * k, (0.03 * k, 0.0, 0.1 * k))  # 0.6 m/s, 2 rad/s
    assert not driver.dropped
    assert driver.belief.pose.theta == pytest.approx(wrap_angle(4.0), abs=1e-3)


@pytest.mark.parametrize("rate", [None, 0.5])
@pytest.mark.parametrize("motion", ["odometry", "encoders"])
def test_a_gyroscope_replaces_the_turns_of_the_wheels(motion, rate):
    robot = load_robot(BURGER)
    robot = dataclasses.replace(robot, odometry=dataclasses.replace(robot.odometry, uses_gyro=True))
    driver = Driver(make_explorer("pursuit"), robot, motion=motion, gyro=True, slam="odometry")
    turn = 0.1 * robot.odometry.track / robot.odometry.metres_per_tick / 2
    for k in range(31):
        counts = -round(k * turn), round(k * turn)
        feed(driver, 0.1 * k, counts if motion == "encoders" else (0.0, 0.0, 0.1 * k), rate=rate)
    turned = wrap_angle(3.0) if rate is None else 3.0 * rate
    assert driver.belief.pose.theta == pytest.approx(turned, abs=0.08)


@pytest.mark.parametrize("pause", [0.0, 2.0])
@pytest.mark.parametrize(("gyro", "rate"), [(False, 0.5), (True, 0.5), (True, None)])
def test_a_recording_holds_the_odometry_of_the_driver_also_of_pauses(gyro, rate, pause, tmp_path):
    how = {"gyro": gyro, "slam": "odometry", "odometry_scales": (1.5, 1.0)}
    driver = Driver(make_explorer("pursuit"), BURGER, **how)
    recorder = BagRecorder(driver.env, tmp_path / "drive.mcap")
    for k in range(61):
        pose = 0.5 * math.sin(0.02 * k), 0.5 - 0.5 * math.cos(0.02 * k), 0.02 * k
        if 2.0 <= 0.1 * k < 2.0 + pause:
            driver.odometry(pose, 0.1 * k)
            if rate is not None:
                driver.imu(rate, 0.1 * k)
        else:
            feed(driver, 0.1 * k, pose, rate=rate)
    recorder.close()
    log = load_log(tmp_path / "drive.mcap")
    steps = between_poses(log.odometry[:-1], log.odometry[1:])
    assert steps[:, 2].sum() == pytest.approx(3.0 if gyro and rate else 1.2, abs=1e-4)
    assert np.hypot(*steps[:, :2].T).sum() == pytest.approx(1.5 * 0.6, abs=0.02)
    assert log.odometry[-1] == pytest.approx(np.array(driver.belief.pose), abs=1e-6)


@pytest.mark.parametrize("planner", ["rpp", "dwb", "mppi"])
def test_a_goal_is_reached_with_its_heading(planner):
    policy = GoalNavigator(GoalParams(local_planner=planner))
    driver = Driver(policy, BURGER, id="lidarnaut/ReachGoal-v0", slam="hector")
    messages = loop_with(driver)
    messages.run(1.0)
    assert driver.reason == "no goal yet"
    for heading in (2.5, -2.0):
        driver.goal(0.6, 0.0, heading)
        assert messages.run(30.0, lambda: driver.reason == "reached")
        assert abs(wrap_angle(messages.robot.start.between(messages.robot.pose).theta - heading)) < 0.3


def test_learned_policies_take_no_headings_unless_a_tolerance_is_given():
    policy, reach = make_policy(lambda observation: np.zeros(2, dtype=np.float32)), {"id": "lidarnaut/ReachGoal-v0"}
    with pytest.raises(ValueError, match="is not known to turn to headings: set a goal x, y, or a heading_tolerance"):
        Driver(policy, BURGER, **reach).goal(1.0, 0.0, 0.0)
    driver = Driver(policy, BURGER, **reach)
    driver.goal(1.0, 0.0)
    assert driver.env.task.heading_tolerance == math.pi
    driver = Driver(policy, BURGER, **reach, heading_tolerance=0.5)
    driver.goal(1.0, 0.0, 2.0)
    assert driver.env.task.heading_tolerance == 0.5


def test_task_observations_and_rate_are_those_of_the_training_of_a_policy():
    policy = learned("twist")
    env = Driver(policy, BURGER, slam="hector").env
    assert (policy.id, env.control_period) == ("lidarnaut/Explore-v0", 0.2)
    assert set(env.observation_space) == set(policy.observations)


def test_a_goal_in_unknown_space_is_reached_after_standing_still_among_people():
    driver = Driver(controller("mppi"), BURGER, id="lidarnaut/ReachGoal-v0", slam="hector")
    robot = SimulatedRobot("turtlebot3_house", BURGER, people=6, seed=0)
    goal, messages = (3.87, 4.35), Loop(driver, robot)
    messages.run(1.0)
    driver.goal(*goal)
    assert messages.run(120.0, lambda: driver.reason == "reached")
    assert math.dist(robot.start.between(robot.pose)[:2], goal) < 0.4


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"motion": "wheels"}, r"motion must be 'odometry' or 'encoders', got 'wheels'"),
        ({"timeout": 0.0}, r"timeout must be positive"),
        ({"control_hz": 0.0}, r"control_hz must be positive"),
        ({"seed": -1}, r"seed must be a whole number from 0"),
        ({"id": "lidarnaut/ExploreTeam-v0"}, r"lidarnaut/ExploreTeam-v0 is not for a single robot"),
        ({"id": "lidarnaut/Navigate-v0"}, r"needs the argument map"),
        ({"slam": "truth"}, r"slam must not be 'truth'"),
        ({"observations": ["scann"]}, r"unknown observation 'scann'"),
    ],
)
def test_wrong_arguments_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Driver(make_explorer("pursuit"), BURGER, **arguments)


def test_what_a_robot_cannot_have_is_refused():
    with pytest.raises(ValueError, match="OracleExplorer uses ground truth"):
        Driver(make_explorer("oracle"), BURGER)
    with pytest.raises(TypeError, match=r"no arguments \['people', 'world'\]: they describe a simulation"):
        Driver(make_explorer("pursuit"), BURGER, world="rooms", people=3)
    driver = Driver(make_explorer("pursuit"), BURGER)
    for call, message in {
        lambda: driver.goal(1.0, 2.0): "task Explore has no goal",
        lambda: driver.encoders(1, 2, 0.0): "encoders need motion='encoders'",
        lambda: driver.odometry((1.0, 2.0), 0.0): r"odometry must be 3 numbers, got \(1.0, 2.0\)",
        lambda: driver.initial_pose(0.0, 0.0, 0.0): "on a known map",
    }.items():
        with pytest.raises(ValueError, match=message):
            call()


def test_a_stop_names_dropped_messages_and_late_stamps():
    driver, ranges = Driver(make_explorer("pursuit"), BURGER), np.full(360, 1.0)
    for _ in range(2):
        driver.odometry((0.0, 0.0, 0.0), 0.0)
    driver.command(0.0)
    assert driver.reason == "no scan yet (dropped: odometry that is not newer than the last)"
    driver.scan(ranges, 5.0)
    driver.command(5.0)
    assert driver.reason == "the stamps of odometry are 5.0 s behind those of scans"


def test_scales_of_odometry_are_found_in_a_log_and_correct_a_robot():
    rng = np.random.default_rng(0)
    steps = np.column_stack([rng.uniform(0.0, 0.1, 200), np.zeros(200), rng.uniform(-0.2, 0.3, 200)])
    truth, measured = [np.zeros(3)], [np.zeros(3)]
    for step in steps:
        truth.append(compose_poses(truth[-1][None], step[None])[0])
        measured.append(compose_poses(measured[-1][None], (step / (1.05, 1.0, 0.9))[None])[0])
    scales = odometry_scales(np.array(measured), np.array(truth))
    assert scales == pytest.approx((1.05, 0.9), abs=0.01)
    driver = Driver(make_explorer("pursuit"), BURGER, slam="odometry", odometry_scales=(1.05, 0.9))
    for k, pose in enumerate(measured):
        feed(driver, 0.5 * k, pose)
    x, y, theta = driver.belief.pose
    assert math.dist((x, y), truth[-1][:2]) < 0.1
    assert abs(wrap_angle(theta - truth[-1][2])) < 0.02


SPINNING = dataclasses.replace(load_robot(BURGER).lidar, scan_time=0.18, noise_std=0.0, resolution=0.0)


@pytest.mark.parametrize("motion", ["odometry", "encoders"])
def test_scans_of_a_lidar_that_spins_are_deskewed(motion):
    burger = load_robot(BURGER)
    burger = dataclasses.replace(burger, drive=dataclasses.replace(burger.drive, slip_std=0.0))
    lidars = SPINNING, dataclasses.replace(SPINNING, scan_time=0.0)
    robots = [SimulatedRobot("turtlebot3_house", dataclasses.replace(burger, lidar=lidar), seed=3) for lidar in lidars]
    delays = SPINNING.time_increment * np.arange(SPINNING.num_beams)
    drivers = [
        Driver(make_explorer("pursuit"), robot.robot, motion=motion, slam="odometry") for robot in robots[:1] * 2
    ]
    errors = []
    for k in range(120):
        spinning, at_once = robots
        for driver, times in zip(drivers, (delays, None)):
            if motion == "encoders":
                driver.encoders(*spinning.reading.ticks, spinning.time)
            else:
                driver.odometry(spinning.odometry, spinning.time)
            if k >= 20 and k % 10 == 0:
                driver.scan(spinning.reading.ranges, spinning.time - delays[-1], times)
                driver.command(spinning.time)
                errors.append(
                    np.abs(np.minimum(driver.env.reading.ranges, 4.0) - np.minimum(at_once.reading.ranges, 4.0))
                )
        for robot in robots:
            robot.step((0.1, 1.5))
    deskewed, skewed = np.array(errors[::2]), np.array(errors[1::2])
    assert np.nanquantile(deskewed, 0.9) < 5e-3
    assert np.nanquantile(skewed, 0.5) > 0.02


def test_a_scan_waits_for_the_odometry_of_its_last_beam():
    driver = Driver(make_explorer("pursuit"), BURGER, slam="odometry")
    delays = np.linspace(0.0, 0.2, 360)
    driver.odometry((0.0, 0.0, 0.0), 1.0)
    driver.odometry((0.0, 0.0, 0.0), 1.1)
    driver.scan(np.full(360, 1.0), 1.0, delays)
    driver.command(1.1)
    assert not driver.has_begun
    driver.odometry((0.0, 0.0, 0.0), 1.2)
    driver.command(1.2)
    assert driver.has_begun
    for wrong in (delays[:10], np.full(360, math.nan), 10.0 * delays):
        with pytest.raises(ValueError, match=r"delays must have shape \(360,\)"):
            driver.scan(np.full(360, 1.0), 1.3, wrong)


@pytest.mark.parametrize("no_return", ["zero", "inf"])
def test_zero_is_no_return_where_the_robot_says_so(no_return, caplog):
    robot = load_robot(BURGER)
    robot = dataclasses.replace(robot, lidar=dataclasses.replace(robot.lidar, no_return=no_return))
    driver, ranges = Driver(make_explorer("pursuit"), robot, slam="odometry"), np.full(360, 1.0)
    ranges[:90], ranges[90:95] = 0.0, (math.nan, -1.0, 0.05, 9.0, math.inf)
    for k in range(5):
        feed(driver, 0.1 * k, ranges=ranges)
    expected = np.full(360, 1.0, dtype=np.float32)
    expected[:90], expected[90:95] = math.inf if no_return == "zero" else math.nan, (*[math.nan] * 3, *[math.inf] * 2)
    np.testing.assert_array_equal(driver.env.reading.ranges, expected)
    warned = [record for record in caplog.records if "25 % of the beams are 0.0" in record.message]
    assert len(warned) == (no_return == "inf")

import dataclasses
import itertools
import math
from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lidarnaut import make_explorer
from lidarnaut.driver import Driver
from lidarnaut.driver.driver import GOAL_REACH
from lidarnaut.driver.gate import KINDS, ImplausibleError, check_numbers
from lidarnaut.driver.wheels import MOST_MESSAGES
from lidarnaut.envs.geometry import OccupancyGrid
from lidarnaut.envs.localization.amcl import INITIAL_STD
from lidarnaut.envs.navigation import GoalNavigator, GoalParams
from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.slam import growing_map

from .feeding import NUM_BEAMS, WALLS, feed

BURGER = "turtlebot3_burger"
BOX = np.full((80, 120), 100, dtype=np.int8)
BOX[2:-2, 2:-2] = 0
BOX_MAP = OccupancyGrid(BOX, 0.05, (-1.0, -1.5))


def explorer(**arguments):
    return Driver(make_explorer("pursuit"), BURGER, **{"slam": "odometry", **arguments})


def goal_driver(id="ReachGoal-v0", **arguments):
    policy = GoalNavigator(GoalParams(local_planner="mppi"))
    return Driver(policy, BURGER, id=f"lidarnaut/{id}", **arguments)


def state(driver):
    known = driver.env.belief.pose if driver.has_begun else None
    return driver.dropped.copy(), len(driver._wheels.messages), len(driver._scans), len(driver._rates), known


@pytest.mark.parametrize(("kind", "name"), [(kind, name) for kind in KINDS for name in KINDS[kind]])
def test_numbers_must_be_finite_and_below_their_limit(kind, name):
    limit, unit = KINDS[kind][name]
    inside = math.nextafter(limit, 0.0)
    for number, message in {
        inside: "",
        -inside: "",
        limit: f"{kind} with {name} beyond {limit:g} {unit}",
        -1e308: f"{kind} with {name} beyond {limit:g} {unit}",
        10**400: f"{kind} with {name} beyond {limit:g} {unit}",
        math.inf: f"{kind} that is not finite",
        math.nan: f"{kind} that is not finite",
    }.items():
        numbers = tuple(number if each == name else 0.0 for each in KINDS[kind])
        if message:
            with pytest.raises(ImplausibleError) as raised:
                check_numbers(kind, numbers)
            assert str(raised.value) == message
        else:
            assert check_numbers(kind, numbers) == numbers


WRONG = (None, "1", [1.0], True, 1j, {}, itertools.count(), np.ones(2), np.True_, np.datetime64("2020-01-01"))


@pytest.mark.parametrize("wrong", WRONG, ids=repr)
def test_what_is_no_number_raises_a_value_error_that_names_the_kind_and_changes_nothing(wrong):
    driver = goal_driver("Navigate-v0", map=BOX_MAP)
    feed(driver, 0.0)
    before = state(driver)
    for kind, call in {
        "odometry": lambda: driver.odometry((wrong, 0.0, 0.0), 1.0),
        "odometry must be 3": lambda: driver.odometry(wrong, 1.0),
        "odometry must be 1": lambda: driver.odometry((0.0, 0.0, 0.0), wrong),
        "imu": lambda: driver.imu(wrong, 1.0),
        "scan": lambda: driver.scan([wrong] * NUM_BEAMS, 1.0),
        "scan ": lambda: driver.scan(wrong, 1.0),
        "scan must be 1": lambda: driver.scan(WALLS, wrong),
        "goal": lambda: driver.goal(0.0, wrong),
        "initial pose": lambda: driver.initial_pose(wrong, 0.0, 0.0),
        "command": lambda: driver.command(wrong),
    }.items():
        with pytest.raises(ValueError, match=f"^{kind}"):
            call()
        assert state(driver) == before
    encoders = explorer(motion="encoders")
    with pytest.raises(ValueError, match=r"^encoders must be 2 numbers, got \(.*; needed: left, right$"):
        encoders.encoders(0, wrong, 0.0)


def test_numbers_may_be_of_numpy():
    driver = explorer()
    driver.odometry(np.zeros(3, dtype=np.float32), np.float64(0.0))
    driver.odometry([np.int64(0), np.float32(0.0), 0], np.int64(1))
    driver.imu(np.float32(0.5), 0)
    driver.scan(WALLS.astype(int).tolist(), np.float32(0.0))
    driver.command(np.float64(1.0))
    assert driver.has_begun
    assert not driver.dropped


NUMBERS = st.sampled_from([0.0, 99.0, 1.9e7, 2e7, 1e16, 1e308, -1e308, 2.0**52, 2.0**62, 5e-324]) | st.floats()
STEPS = st.sampled_from([0.0, 5e-324, 1e-9, 1e-7, 0.9, 3600.0, -0.5, -7200.0, 1e308]) | st.floats()
RANGES = st.sampled_from([0.0, 1e-30, 0.2, 3.4, 1e38, 1e308, math.inf, -math.inf, math.nan]) | st.floats()
PERIODS = st.lists(
    st.tuples(
        st.sampled_from(["good", "good", "x", "theta", "imu", "scan", "delays", "stamp"]), NUMBERS, STEPS, RANGES
    ),
    min_size=10,
    max_size=30,
)


@pytest.mark.parametrize("motion", ["odometry", "encoders"])
@settings(derandomize=True, max_examples=20, deadline=None)
@given(periods=PERIODS)
def test_commands_are_finite_and_within_the_limits_after_all_messages(motion, periods):
    """Control periods of a robot that stands still, some with any numbers, then good ones of a robot that drives."""
    driver, now = explorer(motion=motion, gyro=True), 0.0
    for kind, number, step, distance in periods:
        ranges, delays = WALLS, None
        if kind == "scan":
            ranges = np.where(np.arange(NUM_BEAMS) % 7 == 0, distance, WALLS)
        elif kind == "delays":
            delays = np.linspace(0.0, math.fmod(step, 1.0) if math.isfinite(step) else 1.0, NUM_BEAMS)
        for sign in (1, -1, 1, -1, 1):
            now += 0.02
            stamp = now + step if kind == "stamp" else now
            x, theta = (sign * number if kind == each else 0.0 for each in ("x", "theta"))
            if motion == "odometry":
                driver.odometry((x, -x, theta), stamp)
            else:
                driver.encoders(x + theta, theta - x, stamp)
            driver.imu(number if kind == "imu" else 0.0, stamp)
        now = stamp if abs(stamp) < 1e9 else now
        driver.scan(ranges, stamp, delays)
        v, w = driver.command(stamp)
        assert abs(v) <= driver.robot.max_v
        assert abs(w) <= driver.robot.max_w
        assert not driver.reason or (v, w) == (0.0, 0.0)
        assert not driver.has_begun or math.hypot(*driver.belief.pose[:2]) < 10.0
        assert not driver.has_begun or abs(driver.belief.pose.theta) <= math.pi
    positions = []
    for k in range(10):
        counts = round(0.04 * k / driver.robot.odometry.metres_per_tick)
        feed(driver, now + 1.5 + 0.1 * k, (0.04 * k, 0.0, 0.0) if motion == "odometry" else (counts, counts))
        positions.append(driver.belief.pose[:2])
    assert math.dist(positions[1], positions[-1]) == pytest.approx(0.04 * 8, abs=0.01)


def test_a_scan_is_used_at_least_a_millisecond_after_the_last_one():
    driver = explorer()
    feed(driver, 0.0)
    driver.odometry((0.04, 0.0, 0.0), 5e-324)
    assert driver.dropped == {"odometry that is not newer than the last": 1}
    driver.odometry((0.04, 0.0, 0.0), 1e-4)
    driver.scan(WALLS, 5e-5)
    driver.command(1e-4)
    assert driver.belief.pose.x == 0.0
    driver.odometry((0.04, 0.0, 0.0), 0.1)
    driver.command(0.1)
    assert driver.belief.pose.x == pytest.approx(0.04)
    assert driver.env.robots[0].twist.v == pytest.approx(0.4)


@pytest.mark.parametrize("stamp", [math.nan, math.inf, -math.inf, 1e300, 10**400])
def test_at_an_implausible_time_the_robot_stops(stamp):
    driver = explorer()
    for k in range(5):
        feed(driver, 0.1 * k)
    assert driver.reason == ""
    driver.odometry((0.0, 0.0, 0.0), 0.5)
    driver.scan(WALLS, 0.5)
    assert driver.command(stamp) == (0.0, 0.0)
    assert driver.reason in ("command that is not finite", "command with stamp beyond 8.58993e+09 s")


def test_messages_of_a_flood_are_not_all_kept():
    driver = explorer()
    feed(driver, 0.0)
    for k in range(1, 2 * MOST_MESSAGES):
        driver.odometry((0.0, 0.0, 0.0), 1e-6 * k)
        driver.imu(0.0, 1e-6 * k)
        if k % 16 == 0:
            driver.scan(WALLS, 1.0 + 1e-6 * k)
    assert state(driver)[:4] == (Counter(), MOST_MESSAGES, 256, MOST_MESSAGES)


def test_a_map_that_would_be_too_large_stops_the_robot(monkeypatch):
    driver = explorer()
    feed(driver, 0.0)
    monkeypatch.setattr(growing_map, "MAX_CELLS", driver.belief.grid.data.size)
    for k in range(1, 40):
        command = feed(driver, k, (0.5 * k, 0.0, 0.0))
    assert command == (0.0, 0.0)
    assert driver.reason.startswith("the map would need ")


@pytest.mark.parametrize("motion", ["odometry", "encoders"])
@pytest.mark.parametrize(("rate", "turn"), [(None, 0.0), (0.5, 0.05), (99.0, 0.1 * 1.5 * 3.0)])
def test_the_turn_during_a_jump_is_that_of_the_gyroscope(motion, rate, turn):
    robot = load_robot(BURGER)
    robot = dataclasses.replace(robot, odometry=dataclasses.replace(robot.odometry, uses_gyro=False))
    driver = Driver(make_explorer("pursuit"), robot, motion=motion, slam="odometry")
    for k in range(10):
        place = 0.0 if k < 5 else 40.0
        feed(driver, 0.1 * k, (round(1e5 * place), 0) if motion == "encoders" else (place, place, 0.0), rate=rate)
    assert driver.dropped == {f"jump of {motion}": 1}
    assert driver.belief.pose == pytest.approx((0.0, 0.0, turn), abs=5e-3)


@pytest.mark.parametrize(("motion", "number"), [("odometry", 1e6), ("encoders", 2**52)])
def test_motion_that_jumps_all_the_time_stops_the_robot(motion, number):
    driver = explorer(motion=motion)
    for k in range(40):
        place = number * (-1) ** k if 10 <= k < 30 else 0
        feed(driver, 0.1 * k, (place, -place) if motion == "encoders" else (place, place, 0))
        stops = 20 <= k <= 30
        assert (driver.reason == f"jumps of odometry for {0.1 * (k - 9):.1f} s") == stops == (driver.reason != "")


@pytest.mark.parametrize("has_begun", [False, True])
@pytest.mark.parametrize("is_known", [False, True])
def test_goals_far_from_the_map_are_refused(is_known, has_begun):
    driver = goal_driver("Navigate-v0", map=BOX_MAP) if is_known else goal_driver()
    right = BOX_MAP.bounds[2] if is_known else 0.0
    if has_begun:
        feed(driver, 0.0)
        right = driver.belief.grid.bounds[2]
    allowed = GOAL_REACH + driver.robot.lidar.range_max
    driver.goal(right + allowed - 0.1, 0.0)
    for x, y in ((right + 500.0, 0.0), (0.0, -3000.0), (5e5, 4649776.0)):
        with pytest.raises(ValueError, match=rf"is \d+ m from the map; at most {allowed:.0f} m are allowed"):
            driver.goal(x, y)
    with pytest.raises(ValueError, match=r"goal \(500.0, 0.0\) is "):
        goal_driver(goal=(500.0, 0.0))
    assert driver.env.task.goal[:2] == pytest.approx((right + allowed - 0.1, 0.0))


def test_the_allowed_distance_of_goals_moves_with_the_robot():
    driver = goal_driver(slam="odometry")
    feed(driver, 0.0)
    x = driver.belief.grid.bounds[2] + GOAL_REACH + driver.robot.lidar.range_max + 5.0
    with pytest.raises(ValueError, match="goal"):
        driver.goal(x, 0.0)
    for k in range(1, 20):
        feed(driver, k, (k, 0.0, 0.0))
    driver.goal(x, 0.0)


COVARIANCE = np.zeros((6, 6))
COVARIANCE[0, 0], COVARIANCE[1, 1], COVARIANCE[5, 5], COVARIANCE[0, 1], COVARIANCE[1, 0] = 0.09, 0.01, 0.04, 0.02, 0.02
PLANAR = COVARIANCE[np.ix_([0, 1, 5], [0, 1, 5])]


@pytest.mark.parametrize("has_begun", [False, True])
@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (COVARIANCE.ravel().tolist(), PLANAR),
        (PLANAR, PLANAR),
        (np.diag([0.0, 0.0, 1.0, 1.0, 1.0, 0.0]).ravel(), np.diag(np.square(INITIAL_STD))),
        (None, np.diag(np.square(INITIAL_STD))),
    ],
)
def test_particles_spread_by_the_covariance_of_an_initial_pose(given, expected, has_begun):
    driver = goal_driver("Navigate-v0", map=BOX_MAP)
    if has_begun:
        feed(driver, 0.0)
    driver.initial_pose(1.0, 0.5, 0.3, given)
    if not has_begun:
        feed(driver, 0.0)
    particles = driver.env.robots[0].estimator.particles
    assert particles.mean(axis=0) == pytest.approx((1.0, 0.5, 0.3), abs=0.05)
    np.testing.assert_allclose(np.cov(particles.T), expected, rtol=0.15, atol=0.004)


@pytest.mark.parametrize("has_begun", [False, True])
@pytest.mark.parametrize(
    ("pose", "covariance", "message"),
    [
        ((0.0, 0.0, 0.0), np.diag([1.0, 1.0, -1.0]), "positive semidefinite"),
        ((0.0, 0.0, 0.0), [[1.0, 0.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], "symmetric"),
        ((0.0, 0.0, 0.0), np.diag([1.0, math.nan, 1.0]), "variances"),
        ((0.0, 0.0, 0.0), np.diag([1e308, 1.0, 1.0]), "variances"),
        ((0.0, 0.0, 0.0), np.diag([1.0, 1.0, 1.0]) + 1e200 * (1 - np.eye(3)), "positive semidefinite"),
        ((0.0, 0.0, 0.0), np.ones(35), "finite 3 x 3 matrix"),
        ((0.0, 0.0, 0.0), [None] * 36, "covariance must be numbers"),
        ((0.0, 0.0, 0.0), [[1.0], [1.0, 2.0]], "covariance must be numbers"),
        ((1e6, 0.0, 0.0), None, "outside the map"),
        ((0.0, 0.0, math.nan), None, "initial pose that is not finite"),
        ((1e300, 0.0, 0.0), None, "initial pose with x beyond"),
    ],
)
def test_wrong_initial_poses_are_refused_and_the_estimate_stays(pose, covariance, message, has_begun):
    driver = goal_driver("Navigate-v0", map=BOX_MAP)
    driver.initial_pose(1.0, 0.5, 0.3, 0.01 * np.eye(3))
    if has_begun:
        feed(driver, 0.0)
        before = driver.belief.pose
    with pytest.raises(ValueError, match=message):
        driver.initial_pose(*pose, covariance)
    if has_begun:
        assert driver.belief.pose == before
    else:
        feed(driver, 0.0)
        assert driver.belief.pose[:2] == pytest.approx((1.0, 0.5), abs=0.05)

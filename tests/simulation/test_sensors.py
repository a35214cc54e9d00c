import math
from dataclasses import replace

import numpy as np
import pytest

from lidarnaut.envs.geometry import Pose2D, wrap_angle
from lidarnaut.envs.robots import ImuParams, LidarParams, Mount
from lidarnaut.envs.simulation import Twist, make_simulator
from lidarnaut.envs.simulation.records import robot_record
from lidarnaut.envs.simulation.rows import Rows
from lidarnaut.envs.simulation.sensors import disturb_ranges, sense
from tests.rooms import BURGER, ORIGIN, begin, make_room

WORLD = make_room(-2.0, -3.0, 4.0, 5.0)
LIDAR = LidarParams(num_beams=4, range_max=10.0)


def read(lidar=LIDAR, imu=None, *, pose=ORIGIN, yaw_rate=0.0, seed=0, magnets=()):
    robot = replace(BURGER, lidar=lidar, imu=imu or ImuParams())
    rows = Rows(robot, 0.1, 1)
    row = rows.numbers[0]
    row["x"], row["y"], row["theta"], row["mean_w"] = *pose, yaw_rate
    rows.draw([np.random.default_rng(seed)])
    magnets = np.array(magnets).reshape(-1, 4)
    sense(rows.numbers, rows.draws, rows.ranges, WORLD.segments, np.empty((0, 3)), magnets)
    return rows.reading(0)


UP, DOWN = 1.0 / math.cos(0.05), 0.2 / math.sin(0.1)
"""Relative length of an upward beam to a wall, and length of a downward beam to the floor [m]."""


@pytest.mark.parametrize(
    ("lidar", "pose", "ranges"),
    [
        ({}, (0.0, 0.0, 0.0), [2, 3, 4, 5]),
        ({}, (1.0, 1.0, math.pi / 2), [4, 3, 4, 3]),
        ({"mount": Mount(x=0.5, y=-0.25, yaw=math.pi / 2)}, (0.0, 0.0, 0.0), [2.75, 3.5, 5.25, 2.5]),
        ({"mount": Mount(x=0.5, y=-0.25, yaw=math.pi / 2)}, (0.0, 0.0, math.pi), [4.75, 1.5, 3.25, 4.5]),
        ({"mount": Mount(z=0.2, pitch=0.1)}, (0.0, 0.0, 0.0), [2.0 / math.cos(0.1), 3, DOWN, 5]),
        ({"mount": Mount(z=0.2, roll=0.05)}, (0.0, 0.0, 0.0), [2, 3 * UP, 4, 5 * UP]),
        ({"mount": Mount(z=0.2, roll=0.1)}, (0.0, 0.0, 0.0), [2, DOWN, 4, 5.0 / math.cos(0.1)]),
        ({"num_beams": 3, "fov": math.pi}, (0.0, 0.0, 0.0), [3, 4, 5]),
        ({"range_min": 2.5, "range_max": 3.5}, (0.0, 0.0, 0.0), [math.nan, 3, math.inf, math.inf]),
        ({"resolution": 0.3}, (0.0, 0.0, 0.0), [2.1, 3.0, 3.9, 5.1]),
    ],
)
def test_a_lidar_measures_the_box(lidar, pose, ranges):
    measured = read(replace(LIDAR, **lidar), pose=Pose2D(*pose)).ranges
    assert measured.dtype == np.float32
    np.testing.assert_allclose(measured, ranges, rtol=1e-6)


@pytest.mark.parametrize("mount", [{"z": 0.2, "pitch": 0.5}, {"z": 0.2, "roll": math.nan}, {"pitch": 0.1}])
def test_mounts_that_make_no_sense_are_refused(mount):
    with pytest.raises(ValueError, match=r"(pitch|roll|z)"):
        Mount(**mount)


def test_noise_and_dropout_have_the_stated_size():
    lidar = LidarParams(num_beams=20_000, range_max=10.0, noise_std=0.02, dropout=0.1)
    exact = read(replace(lidar, noise_std=0.0, dropout=0.0)).ranges
    ranges = read(lidar).ranges
    lost = np.isnan(ranges)
    assert lost.mean() == pytest.approx(0.1, abs=4 * math.sqrt(0.1 * 0.9 / 20_000))
    errors = (ranges - exact)[~lost]
    assert errors.std() == pytest.approx(0.02, rel=0.03)
    assert abs(errors.mean()) < 4 * 0.02 / math.sqrt(len(errors))


def test_disturbing_equals_the_plain_formula():
    rng = np.random.default_rng(1)
    exact = rng.uniform(0, 5, 1000).astype(np.float32)
    exact[::7] = np.inf
    normals, uniforms = rng.standard_normal(1000), rng.random(1000)
    ranges = exact.copy()
    lidar = LidarParams(1000, range_max=4.0, range_min=0.2, noise_std=0.05, resolution=0.015, dropout=0.02)
    draws = np.concatenate([normals, uniforms])
    disturb_ranges(ranges, draws, robot_record(replace(BURGER, lidar=lidar), 0.1))
    with np.errstate(invalid="ignore"):
        measured = 0.015 * np.floor((exact.astype(float) + 0.05 * normals) / 0.015 + 0.5)
    expected = np.where((exact < 0.2) | (measured < 0.2), np.nan, measured)
    expected = np.where(measured > 4.0, np.inf, expected)
    expected = np.where(uniforms < 0.02, np.nan, expected).astype(np.float32)
    np.testing.assert_array_equal(ranges, expected)


def test_gyroscope_and_compass():
    imu = ImuParams(gyro_std=0.05, has_compass=True, compass_std=0.1, compass_resolution=0.02)
    readings = [read(imu=imu, pose=Pose2D(0, 0, 3.1), yaw_rate=0.7, seed=seed) for seed in range(2000)]
    rates = np.array([reading.yaw_rate for reading in readings])
    headings = np.array([reading.heading for reading in readings])
    assert rates.mean() == pytest.approx(0.7, abs=0.005)
    assert rates.std() == pytest.approx(0.05, rel=0.07)
    assert np.all((headings >= -math.pi) & (headings < math.pi))
    unwrapped = np.where(headings < 0, headings + 2 * math.pi, headings)
    assert unwrapped.mean() == pytest.approx(3.1, abs=0.01)
    assert unwrapped.std() == pytest.approx(0.1, rel=0.07)
    steps = unwrapped[headings > 0] / 0.02
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    assert math.isnan(read().heading)


def test_compass_errors_of_the_robot_and_of_the_world():
    imu = ImuParams(has_compass=True, compass_offset=0.1, compass_deviation=0.2, compass_deviation_phase=0.5)
    for theta in (-3.1, 0.5, 1.7, 3.1):
        expected = theta + 0.1 + 0.2 * math.sin(theta - 0.5)
        assert read(imu=imu, pose=Pose2D(0, 0, theta)).heading == pytest.approx(wrap_angle(expected))
    magnets = [[2.0, 0.0, 0.4, 3.0], [0.0, 4.0, -0.3, 1.0]]
    for x, expected in ((0.0, 0.4 / 8 - 0.3 / 4), (1.5, 0.4 - 0.3 / math.hypot(1.5, 4.0)), (2.0, 0.4 - 0.3 / 20**0.5)):
        reading = read(imu=ImuParams(has_compass=True), pose=Pose2D(x, 0, 0), magnets=magnets)
        assert reading.heading == pytest.approx(expected)


def test_magnets_disturb_the_compass_under_both_physics(physics):
    robot = replace(BURGER, imu=ImuParams(has_compass=True))
    world = replace(WORLD, magnets=np.array([[0.5, 0.0, 0.4, 2.0]]))
    simulator = begin(physics, robot, world, ORIGIN)
    assert simulator.step([Twist(0.1, 0.0)])[0].heading == pytest.approx(0.4, abs=0.01)
    plain = begin(physics, robot, WORLD, ORIGIN)
    assert plain.step([Twist(0.1, 0.0)])[0].heading == pytest.approx(0.0, abs=0.01)


def test_the_gyroscope_measures_the_mean_yaw_rate_of_the_period(physics):
    """The integral is the change of heading, also during acceleration and slip."""
    simulator = begin(physics, replace(BURGER, imu=ImuParams()), WORLD, ORIGIN)
    commands = np.random.default_rng(1)
    for step in range(60):
        if step % 5 == 0:
            command = Twist(*commands.uniform([-0.1, -2.8], [0.1, 2.8]))
        before = simulator.states[0].pose.theta
        [reading] = simulator.step([command])
        turn = wrap_angle(simulator.states[0].pose.theta - before)
        assert 0.1 * reading.yaw_rate == pytest.approx(turn, abs=1e-9)


def test_the_gyroscope_measures_turns_beyond_half_a_circle(physics):
    simulator = begin(physics, replace(BURGER, imu=ImuParams()), WORLD, ORIGIN, period=2.0)
    for _ in range(3):
        [reading] = simulator.step([Twist(0.0, 2.0)])
    assert reading.yaw_rate == pytest.approx(2.0, rel=0.02)


def test_the_bias_of_the_gyroscope_lasts_from_reset_to_reset(physics):
    imus = ImuParams(gyro_bias_std=0.01), ImuParams()
    simulator, unbiased = (make_simulator(physics, replace(BURGER, imu=imu), 0.1) for imu in imus)
    biases = []
    for seed in range(200):
        readings = simulator.reset(WORLD, [ORIGIN], [np.random.default_rng(seed)])
        readings += [simulator.step([Twist(0.0, 0.0)])[0] for _ in range(2)]
        rates = [reading.yaw_rate for reading in readings]
        assert np.ptp(rates) < 5e-4
        biases.append(rates[0])
    assert np.std(biases) == pytest.approx(0.01, rel=0.15)
    assert abs(np.mean(biases)) < 0.003
    same = unbiased.reset(WORLD, [ORIGIN], [np.random.default_rng(199)])[0]
    np.testing.assert_array_equal(same.ranges, readings[0].ranges)
    assert same.yaw_rate == 0.0

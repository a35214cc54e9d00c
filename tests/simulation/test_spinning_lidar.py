import math
from dataclasses import replace

import gymnasium
import numpy as np
import pytest

from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.geometry.raycast import Beams, cast_rays
from lidarnaut.envs.robots import LidarParams, Mount
from lidarnaut.envs.simulation import Twist, make_simulator
from lidarnaut.envs.worlds.world import FixedRoute
from tests.rooms import BURGER, make_room

SCAN_TIME = 0.18
LIDAR = LidarParams(360, 10.0, mount=Mount(x=-0.03, y=0.02, z=0.1, yaw=0.3))
ROBOT = replace(BURGER, lidar=LIDAR, drive=replace(BURGER.drive, slip_std=0.0), imu=replace(BURGER.imu, gyro_std=0.0))
ROBOT = replace(ROBOT, imu=replace(ROBOT.imu, gyro_bias_std=0.0))
ROUTE = FixedRoute(0.2, np.array([(1.5, -1.5), (1.5, 1.5)]), 1.0)
ROOM = make_room(-2.0, -3.0, 4.0, 5.0, circles=[(-1.0, 2.0, 0.2)], people=[ROUTE])


def drive(physics, scan_time, period, *, deskews=True, lidar=LIDAR, seconds=2.0, num_robots=1):
    """Return poses, people and scans at the ends of all periods of a drive around curves."""
    robot = replace(ROBOT, lidar=replace(lidar, scan_time=scan_time))
    simulator = make_simulator(physics, robot, period, num_robots)
    simulator.deskews = deskews
    starts = [Pose2D(0.0, 2.0 * k, 3.0) for k in range(num_robots)]
    rngs = [np.random.default_rng(k) for k in range(num_robots)]
    readings = simulator.reset(ROOM, starts, rngs, np.random.default_rng(9))
    record = []
    for k in range(round(seconds / period) + 1):
        people = simulator.people[:, [0, 1, 4]].copy()
        record.append(([state.pose for state in simulator.states], people, [one.ranges for one in readings]))
        readings = simulator.step([Twist(0.2, 2.0 * math.cos(2.0 * k * period))] * num_robots)
    return record


def single_beams(record, period, lidar):
    """Return the scan of the first robot at the end of a drive, of beams cast one by one from their own poses."""
    poses = np.array([entry[0][0] for entry in record])
    poses[:, 2] = np.unwrap(poses[:, 2])
    times, ranges = np.arange(len(record)) * period, np.empty(lidar.num_beams)
    for k, angle in enumerate(lidar.angles):
        at = times[-1] - (lidar.num_beams - 1 - k) * SCAN_TIME * lidar.angle_increment / (2.0 * math.pi)
        x, y, theta = (np.interp(at, times, column) for column in poses.T)
        moving = [[(*peer[:2], ROBOT.radius) for peer in entry[0][1:]] for entry in record]
        bodies = np.array([[*ROOM.circles, *entry[1], *peers] for entry, peers in zip(record, moving)])
        circles = [[np.interp(at, times, bodies[:, i, j]) for j in range(3)] for i in range(bodies.shape[1])]
        sensor = Pose2D(x, y, theta).compose(Pose2D(lidar.mount.x, lidar.mount.y, lidar.mount.yaw + angle))
        out = ranges[k : k + 1]
        cast_rays(*sensor, Beams(0.0, 0.1, lidar.range_max), ROOM.segments, np.array(circles), out)
    return ranges


@pytest.mark.parametrize(("period", "fov", "num_robots"), [(0.1, 2.0 * math.pi, 2), (0.02, 4.0, 1), (0.5, 6.0, 1)])
def test_each_beam_is_measured_at_its_own_time(physics, period, fov, num_robots):
    lidar = replace(LIDAR, fov=fov)
    record = drive(physics, SCAN_TIME, period, deskews=False, lidar=lidar, num_robots=num_robots)
    error = np.abs(record[-1][2][0] - single_beams(record, period, lidar))
    assert np.quantile(error, 0.98) < 2e-3  # beams beside an edge may pass
    at_once = drive(physics, 0.0, period, lidar=lidar, num_robots=num_robots)
    assert at_once[-1][0] == record[-1][0]
    assert np.quantile(np.abs(at_once[-1][2][0] - record[-1][2][0]), 0.9) > 0.05


@pytest.mark.parametrize("period", [0.1, 0.02])
def test_deskewed_scans_equal_those_of_all_beams_at_once(physics, period):
    scans, skewed, exact = (
        np.array([entry[2][0] for entry in drive(physics, time, period, deskews=deskews)])
        for time, deskews in ((SCAN_TIME, True), (SCAN_TIME, False), (0.0, True))
    )
    assert np.isnan(scans).mean() < 0.03  # turning against the lidar leaves a gap
    assert np.nanquantile(np.abs(scans - exact), 0.9) < 2e-3
    assert np.nanquantile(np.abs(skewed - exact), 0.5) > 0.02
    np.testing.assert_allclose(scans[0], exact[0], rtol=1e-5)  # at rest


def test_vector_environments_step_it_as_single_ones():
    robot = replace(BURGER, lidar=replace(BURGER.lidar, scan_time=SCAN_TIME))
    arguments = {"world": "turtlebot3_world", "robot": robot, "physics": "kinematic", "people": 2}
    vector = gymnasium.make_vec("lidarnaut/Explore-v0", num_envs=2, **arguments)
    single = gymnasium.make("lidarnaut/Explore-v0", **arguments)
    both = [vector.reset(seed=3)[0], single.reset(seed=3)[0]]
    for k in range(15):
        action = np.array([0.5, math.sin(k)], dtype=np.float32)
        both = [vector.step(np.stack([action, action]))[0], single.step(action)[0]]
    for name in both[1]:
        np.testing.assert_array_equal(both[0][name][0], both[1][name])

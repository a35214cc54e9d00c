import functools
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lidarnaut.envs.estimation import ORIGIN
from lidarnaut.envs.estimation.motion import WheelMotion
from lidarnaut.envs.geometry import FREE, UNKNOWN, OccupancyGrid, Pose2D, wrap_angle
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import make_simulator
from lidarnaut.envs.slam import base_name, make_slam
from lidarnaut.envs.worlds import World

from .route import END, Progress, Route, steer

PRESET = Path(__file__).parent / "route_map.yaml"
"""File of TinySLAM parameters for a mapping drive with a compass."""
LOOKAHEAD = 0.6
"""Lookahead distance of pure pursuit in the mapping drive [m]."""
UPDATE_DISTANCE = 0.2
"""Driven distance after which the mapping drive adds the next scan to the map [m]."""
UPDATE_ANGLE = 0.15
"""Turn after which the mapping drive adds the next scan to the map [rad]."""


@dataclass(frozen=True, slots=True, eq=False)
class RouteMap:
    """Map of a route and estimated poses of the mapping drive."""

    grid: OccupancyGrid
    """Occupancy grid in the frame of the route's start."""
    north: float
    """Compass heading of the map's x axis [rad]; NaN without a compass."""
    poses: np.ndarray
    """Estimated poses of the mapping drive: shape (n, 3), float64, map frame [m, m, rad]."""


@functools.lru_cache(maxsize=32)
def make_route_map(
    world: World,
    robot: RobotParams,
    physics: str,
    slam: str,
    path: bytes,
    resolution: float,
    control_period: float,
    seed: int,
) -> RouteMap:
    """Drive along a route, map it with a SLAM, and return the map (cached).

    The SLAM gets wheel odometry and compass headings. Scans are mapped at intervals, to limit the drift from scan
    noise. `path`: bytes of route points, float64, shape (n, 2), world frame [m]; `resolution`: map cell size [m].
    RuntimeError if the robot does not reach the end.
    """
    route = Route.of(np.frombuffer(path).reshape(-1, 2))
    simulator_rng, slam_rng = np.random.default_rng(seed).spawn(2)
    simulator = make_simulator(physics, robot, control_period)
    reading = simulator.reset(world, [route.start], [simulator_rng])[0]
    name, has_compass = base_name(slam), robot.imu.has_compass
    how = (PRESET, None) if name == "tinyslam" and has_compass else ("default", robot.odometry.noise)
    mapper = make_slam(slam, robot.lidar, resolution, *how)
    mapper.reset(slam_rng)
    wheels = WheelMotion(robot)
    wheels.reset(reading)
    uses_compass = has_compass and name != "truth"
    beliefs = [mapper.update(reading, ORIGIN).pose]
    headings = [reading.heading]
    progress, truth, motion, heading = Progress(route), route.start, ORIGIN, reading.heading
    # twice the time at maximum speed, plus 30 s
    steps_left = round((2.0 * route.length / robot.max_v + 30.0) / control_period)
    while progress.update(truth)[0] < route.length - END:
        if steps_left == 0:
            raise RuntimeError(
                f"robot {robot.name!r} did not reach the end of the route in world {world.name!r}: it stopped "
                f"{route.along[progress.index]:.1f} m from the start, of {route.length:.1f} m"
            )
        steps_left -= 1
        before = truth
        reading = simulator.step([steer(progress, truth, robot.max_v, LOOKAHEAD)])[0]
        truth = simulator.states[0].pose
        step = before.between(truth) if name == "truth" else wheels.update(reading)
        if uses_compass:
            step, heading = _turned(step, reading.heading - heading), reading.heading
        motion = motion.compose(step)
        if math.hypot(motion.x, motion.y) < UPDATE_DISTANCE and abs(motion.theta) < UPDATE_ANGLE:
            continue
        if uses_compass:
            # Absolute headings correct earlier matching errors.
            turned = reading.heading - headings[0] - mapper.belief.pose.theta
            motion = motion._replace(theta=float(wrap_angle(turned)))
        beliefs.append(mapper.update(reading, motion).pose)
        headings.append(reading.heading)
        motion = ORIGIN
    simulator.close()
    poses, grid = np.array(beliefs), mapper.belief.grid
    _clear_driven(grid, poses, 0.5 * robot.radius)
    offset = np.mean(np.exp(1j * (np.array(headings) - poses[:, 2])))
    return RouteMap(grid, math.atan2(offset.imag, offset.real), poses)


def _turned(motion: Pose2D, turn: float) -> Pose2D:
    turn = float(wrap_angle(turn))
    length = math.copysign(math.hypot(motion.x, motion.y), motion.x)
    return Pose2D(length * math.cos(0.5 * turn), length * math.sin(0.5 * turn), turn)


def _clear_driven(grid: OccupancyGrid, poses: np.ndarray, radius: float) -> None:
    reach = math.ceil(radius / grid.resolution)
    disc = np.indices((2 * reach + 1, 2 * reach + 1)).reshape(2, -1).T - reach
    disc = disc[np.hypot(*disc.T) * grid.resolution <= radius]
    cells = (grid.cells(poses[:, :2])[:, None] + disc).reshape(-1, 2)
    rows, columns = cells[grid.contains(cells)].T
    driven = grid.data[rows, columns]
    grid.data[rows, columns] = np.where(driven == UNKNOWN, FREE, driven)

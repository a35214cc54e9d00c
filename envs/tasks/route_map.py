import functools
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lidarnaut.envs.geometry import FREE, ORIGIN, UNKNOWN, OccupancyGrid, Pose2D
from lidarnaut.envs.navigation import crop_to_known
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Reading, make_simulator
from lidarnaut.envs.slam import KnownPoses, base_name, load_params, make_slam
from lidarnaut.envs.slam.scan_alignment import align_scans
from lidarnaut.envs.worlds import World

from .route import END, Progress, Route, steer

LOOKAHEAD = 0.6
"""Lookahead distance of pure pursuit in the mapping drive [m]."""
UPDATE_DISTANCE = 0.2
"""Driven distance after which the mapping drive adds the next scan to the map [m]."""
UPDATE_ANGLE = 0.15
"""Turn after which the mapping drive adds the next scan to the map [rad]."""

PIVOT_PRIOR = 0.04
"""Squared ratio of the errors across of a scan's pose (2 mm) and of the expected pivot (1 cm) [rad2]."""


@dataclass(frozen=True, slots=True, eq=False)
class RouteMap:
    """Map of a route and estimated poses of the mapping drive."""

    grid: OccupancyGrid
    """Occupancy grid in the frame of the route's start."""
    north: float
    """Compass heading of the map's x axis [rad]; NaN without a compass."""
    pivot: float
    """Distance from the axle to the point without sideslip (`find_pivot`), forwards [m]."""
    poses: np.ndarray
    """Estimated poses of the mapping drive: shape (n, 3), float64, map frame [m, m, rad]."""


@functools.lru_cache(maxsize=32)
def make_route_map(
    world: World,
    robot: RobotParams,
    physics: str,
    slam: Any,
    path: bytes,
    resolution: float,
    control_period: float,
    seed: int,
) -> RouteMap:
    """Drive along a route, map it with a SLAM, and return the map (cached).

    The SLAM gets odometry, and the compass is not used. Scans are mapped at intervals, to limit the drift from
    scan noise. After the drive, all scans are aligned with each other (`align_scans`), except with the SLAMs `truth`
    and `odometry`, whose poses are used as they are.
    `path`: bytes of route points, float64, shape (n, 2), world frame [m]; `resolution`: map cell size [m].
    RuntimeError if the robot does not reach the end.
    """
    route = Route.of(np.frombuffer(path).reshape(-1, 2))
    simulator_rng, slam_rng = np.random.default_rng(seed).spawn(2)
    simulator = make_simulator(physics, robot, control_period)
    reading = simulator.reset(world, [route.start], [simulator_rng])[0]
    name, mapper = base_name(slam), make_slam(slam, robot.lidar, odometry_noise=robot.odometry.noise)
    mapper.reset(slam_rng)
    poses, readings, motions = [mapper.update(reading, ORIGIN).pose], [reading], list[Pose2D]()
    progress, truth, motion = Progress(route), route.start, ORIGIN
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
        motion = motion.compose(before.between(truth) if name == "truth" else reading.motion)
        if math.hypot(motion.x, motion.y) < UPDATE_DISTANCE and abs(motion.theta) < UPDATE_ANGLE:
            continue
        poses.append(mapper.update(reading, motion).pose)
        readings.append(reading)
        motions.append(motion)
        motion = ORIGIN
    simulator.close()
    found = np.array(poses)
    if name not in ("truth", "odometry"):
        found = align_scans(np.array([reading.ranges for reading in readings]), found, robot.lidar)
    grid = _draw(robot, readings, found, resolution, getattr(mapper, "params", None))
    _clear_driven(grid, found, 0.5 * robot.radius)
    offset = np.mean(np.exp(1j * (np.array([reading.heading for reading in readings]) - found[:, 2])))
    return RouteMap(grid, math.atan2(offset.imag, offset.real), find_pivot(found, np.array(motions)), found)


def find_pivot(poses: np.ndarray, motions: np.ndarray) -> float:
    """Return the distance from the axle to the point without sideslip [m], by least squares over a drive.

    Encoders do not measure the sideslip `v_y = -x w`; x: coordinate of the instantaneous centre of rotation (Mandow et
    al., "Experimental kinematics for wheeled skid-steer mobile robots", 2007). `poses`: base poses, shape (n, 3);
    `motions`: odometry, each pose relative to the pose before, shape (n - 1, 3); both float64 [m, m, rad].
    """
    steps = itertools.pairwise(itertools.starmap(Pose2D, poses.tolist()))
    moved = np.array([before.between(pose) for before, pose in steps]).reshape(-1, 3)
    (x, y, _), half = (motions.reshape(-1, 3) - moved).T, 0.5 * moved[:, 2]
    turns = 2.0 * np.sin(half)
    return float(turns @ (np.cos(half) * y - np.sin(half) * x) / (turns @ turns + PIVOT_PRIOR))


def _draw(
    robot: RobotParams, readings: Sequence[Reading], poses: np.ndarray, resolution: float, params: Any
) -> OccupancyGrid:
    shared = {name: getattr(params, name) for name in ("max_range", "skip_exceeding") if hasattr(params, name)}
    changes = {**shared, "resolution": resolution, "hole_width": 0.04, "min_travel_distance": 0.0}
    mapper, before = KnownPoses(robot.lidar, load_params("default", changes)), ORIGIN
    for reading, pose in zip(readings, itertools.starmap(Pose2D, poses.tolist()), strict=True):
        mapper.update(reading, before.between(pose))
        before = pose
    return crop_to_known(mapper.belief.grid)


def _clear_driven(grid: OccupancyGrid, poses: np.ndarray, radius: float) -> None:
    reach = math.ceil(radius / grid.resolution)
    disc = np.indices((2 * reach + 1, 2 * reach + 1)).reshape(2, -1).T - reach
    disc = disc[np.hypot(*disc.T) * grid.resolution <= radius]
    cells = (grid.cells(poses[:, :2])[:, None] + disc).reshape(-1, 2)
    rows, columns = cells[grid.contains(cells)].T
    driven = grid.data[rows, columns]
    grid.data[rows, columns] = np.where(driven == UNKNOWN, FREE, driven)

"""How well SLAM keeps track of a simulated robot, beside what its wheels alone would believe.

A robot that knows the truth runs errands between random places of a world, so that the route does not depend on the
estimate. Errors are those of the believed pose against the true one, both seen from the start, over all scans of a
drive. Run `python -m benchmarks.slam_drive --help`.
"""

import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro

from envs.coverage import ExplorableArea, explorable_area, map_iou
from envs.geometry import Pose2D, wrap_angle
from envs.navigation import CostmapParams, make_costmap, plan_path
from envs.robots import RobotParams, WheelOdometry, load_robot
from envs.simulation import Twist, make_simulator
from envs.slam import Slam, make_slam
from envs.worlds import World, load_world

RESOLUTION = 0.05
"""Side of a map cell [m]."""


class Errands:
    """Drives to one random place of a known world after another."""

    def __init__(self, robot: RobotParams, area: ExplorableArea, rng: np.random.Generator) -> None:
        """Prepare for a drive; places are drawn from `rng`."""
        self._robot = robot
        self._area = area
        self._rng = rng
        params = CostmapParams(robot_radius=robot.radius + 0.02, inflation_radius=robot.radius + 0.5)
        self._costmap = make_costmap(area.walls, params)
        self._path = np.empty((0, 2))

    def act(self, pose: Pose2D) -> Twist:
        """Return the next command for a robot at `pose` (world frame)."""
        self._forget_passed(pose)
        while len(self._path) == 0:
            goal = self._area.draw_pose(self._rng)
            path = plan_path(self._costmap, pose[:2], goal[:2], tolerance=0.3)
            self._path = np.empty((0, 2)) if path is None else path
            self._forget_passed(pose)
        carrot = pose.inverse().transform(self._path[:1])[0]
        angle = math.atan2(carrot[1], carrot[0])
        top_w = min(self._robot.max_w, 1.0)
        if abs(angle) > 0.6:
            return Twist(0.0, math.copysign(top_w, angle))
        speed = self._robot.max_v * math.cos(angle) ** 2
        return Twist(speed, float(np.clip(2.0 * angle, -top_w, top_w)))

    def _forget_passed(self, pose: Pose2D) -> None:
        """Drop the points of the path that lie within reach."""
        near = np.flatnonzero(np.hypot(*(self._path - pose[:2]).T) < 0.3)
        if len(near):
            self._path = self._path[near[-1] + 1 :]


@dataclass(frozen=True, slots=True)
class DriveErrors:
    """Errors of one drive."""

    seed: int
    """Seed of the drive."""
    path_length: float
    """How far the robot drove [m]."""
    slam_position: float
    """Root mean square distance between believed and true position [m]."""
    slam_heading: float
    """Root mean square error of the believed heading [deg]."""
    odometry_position: float
    """The same distance for wheel odometry alone [m]."""
    odometry_heading: float
    """The same error for wheel odometry alone [deg]."""
    slam_position_aligned: float
    """Root mean square distance left [m] once the estimated trajectory is laid over the true one as well as it goes:
    what is wrong within the map, without its turn against the start."""
    map_iou: float
    """Agreement of the map's occupied cells with the walls, within 0.1 m, from 0 to 1."""
    map_iou_aligned: float
    """The same after that alignment."""


def drive(
    world: World, robot: RobotParams, physics: str, slam: Slam, seed: int, duration: float, control_period: float = 0.1
) -> DriveErrors:
    """Send a robot on errands from the world's first spawn, and compare what it believes with the truth.

    Args:
        world: where.
        robot: who.
        physics: by which physics.
        slam: what estimates the pose; it is reset.
        seed: of everything random.
        duration: length of the drive [s].
        control_period: time between two commands and scans [s].
    """
    rng_simulator, rng_slam, rng_driver = np.random.default_rng(seed).spawn(3)
    area = explorable_area(world, robot, RESOLUTION)
    driver = Errands(robot, area, rng_driver)
    simulator = make_simulator(physics, robot, control_period)
    start = world.spawns[0]
    reading = simulator.reset(world, [start], [rng_simulator])[0]
    wheels = WheelOdometry(robot)
    wheels.reset(reading.ticks)
    slam.reset(rng_slam)
    belief = slam.update(reading.ranges, Pose2D(0.0, 0.0, 0.0))
    odometry = Pose2D(0.0, 0.0, 0.0)
    truth = start
    errors, poses = [], []
    path_length = 0.0
    for _ in range(round(duration / control_period)):
        before = truth
        reading = simulator.step([driver.act(truth)])[0]
        truth = simulator.states[0].pose
        motion = wheels.update(reading.ticks)
        odometry = odometry.compose(motion)
        belief = slam.update(reading.ranges, motion)
        path_length += math.hypot(truth.x - before.x, truth.y - before.y)
        errors.append((*pose_error(belief.pose, start, truth), *pose_error(odometry, start, truth)))
        poses.append((*belief.pose[:2], *truth[:2]))
    simulator.close()
    believed, true = np.split(np.array(poses), 2, axis=1)
    frame = alignment(believed, true)
    rms = np.sqrt(np.mean(np.square(errors), axis=0)).tolist()
    return DriveErrors(
        seed=seed,
        path_length=path_length,
        slam_position=rms[0],
        slam_heading=math.degrees(rms[1]),
        odometry_position=rms[2],
        odometry_heading=math.degrees(rms[3]),
        slam_position_aligned=float(np.sqrt(np.mean(np.sum((frame.transform(believed) - true) ** 2, axis=1)))),
        map_iou=map_iou(belief.grid, area, start),
        map_iou_aligned=map_iou(belief.grid, area, frame),
    )


def pose_error(believed: Pose2D, start: Pose2D, truth: Pose2D) -> tuple[float, float]:
    """Return distance [m] and angle [rad] between a pose believed, as seen from the start, and the true one."""
    error = start.compose(believed).between(truth)
    return math.hypot(error.x, error.y), abs(wrap_angle(error.theta))


def alignment(believed: np.ndarray, true: np.ndarray) -> Pose2D:
    """Return the frame in which positions come closest to others, in the least squares sense.

    Args:
        believed: shape (n, 2), in the frame sought [m].
        true: shape (n, 2), in the world frame [m].
    """
    u, v = believed - believed.mean(axis=0), true - true.mean(axis=0)
    theta = math.atan2(float(np.sum(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])), float(np.sum(u * v)))
    x, y = true.mean(axis=0) - Pose2D(0.0, 0.0, theta).transform(believed.mean(axis=0))
    return Pose2D(float(x), float(y), theta)


def main(
    world: str = "turtlebot3_world",
    robot: str = "turtlebot3_burger",
    physics: Literal["bullet", "kinematic"] = "bullet",
    slam: str = "tinyslam",
    seeds: int = 5,
    minutes: float = 5.0,
    json_path: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
) -> None:
    """Measure SLAM on simulated drives.

    Args:
        world: library world, or path of a world file.
        robot: library robot, or path of a robot file.
        physics: by which physics the robot drives.
        slam: which SLAM.
        seeds: number of drives.
        minutes: length of each drive [min].
        json_path: also write the numbers to this file.
    """
    place, machine = load_world(world), load_robot(robot)
    estimator = make_slam(slam, machine.lidar, RESOLUTION)
    results = []
    print(f"{machine.name} in {place.name}, {physics} physics, {slam}, {minutes:g} min per drive")
    print("seed   path  |     position RMSE [m]      | heading RMSE [deg] |    map IoU")
    print("        [m]  |   slam (aligned) odometry  |   slam  odometry   |      (aligned)")
    for seed in range(seeds):
        result = drive(place, machine, physics, estimator, seed, 60.0 * minutes)
        results.append(result)
        print(_row(str(seed), [result]))
    print(_row("med", results))
    if json_path is not None:
        json_path.write_text(json.dumps([asdict(result) for result in results], indent=2) + "\n")


def _row(name: str, results: list[DriveErrors]) -> str:
    """Return a line of the table, with medians over the drives."""

    def median(field: str) -> float:
        return float(np.median([getattr(result, field) for result in results]))

    position = (
        f"{median('slam_position'):7.3f}   ({median('slam_position_aligned'):.3f}) {median('odometry_position'):9.3f}"
    )
    heading = f"{median('slam_heading'):7.2f} {median('odometry_heading'):9.2f}"
    iou = f"{median('map_iou'):.2f}   ({median('map_iou_aligned'):.2f})"
    return f"{name:>4} {median('path_length'):6.1f}  | {position}  | {heading}  | {iou}"


if __name__ == "__main__":
    tyro.cli(main)

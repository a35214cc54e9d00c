"""Accuracy of SLAM on simulated drives, compared with that of the robot's own odometry.

A robot drives by ground truth to random goals of a world, so that the route does not depend on the estimate. Errors are
those of the estimated pose, in the frame of the start, over all scans of a drive. Run
`python -m benchmarks.slam_drive --help`.
"""

import json
import math
import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import numpy as np
import tyro

from benchmarks.recorded_drives import RESOLUTION, Drive, Setup, make_setup, record
from envs.command_line import Count, run_command
from envs.estimation import Estimator
from envs.geometry import Pose2D
from envs.logs import compose_poses, pose_errors, rms
from envs.robots import load_robot
from envs.simulation import Reading
from envs.slam import DEFAULT_SLAM, make_slam
from envs.tasks.coverage import map_iou
from envs.worlds import load_world


class DriveErrors(NamedTuple):
    """Errors of one drive, root mean squares over its scans, and how the map overlaps the walls, from 0 to 1."""

    seed: int
    path_length: float
    """Length of the robot's path [m]."""
    slam_position: float
    """[m]"""
    slam_heading: float
    """[deg]"""
    odometry_position: float
    """By wheel odometry alone [m]."""
    odometry_heading: float
    """By wheel odometry alone [deg]."""
    slam_position_aligned: float
    """After alignment of the estimated trajectory with the true one [m]: errors within the map, without that of its
    heading against the start."""
    map_iou: float
    """Intersection over union of the map's occupied cells with the walls, within 0.1 m."""
    map_iou_aligned: float
    """The same after that alignment."""
    milliseconds: float
    """Mean time per scan [ms]."""
    milliseconds_p99: float
    """99th percentile of the time per scan [ms]."""


def record_drive(setup: Setup, seed: int, duration: float) -> Drive:
    """Drive a robot from the world's first spawn to random goals, so long [s]; the seed is that of noise and goals."""
    rng_simulator, _, rng_driver = np.random.default_rng(seed).spawn(3)
    return record(setup, setup.world.spawns[0], rng_simulator, rng_driver, duration)


def evaluate(setup: Setup, recorded: Drive, slam: Estimator, seed: int) -> DriveErrors:
    """Run a SLAM along the drive that `record_drive` recorded with a seed, and compare its poses with the true ones."""
    slam.reset(np.random.default_rng(seed).spawn(2)[1])
    start, truth = setup.world.spawns[0], recorded.truth[1:]
    odometry, estimates, dead_reckoning = Pose2D(0.0, 0.0, 0.0), [], []
    seconds = np.empty(len(recorded.ranges))
    for k, (ranges, motion) in enumerate(zip(recorded.ranges, recorded.motions.tolist())):
        odometry = odometry.compose(Pose2D(*motion))
        dead_reckoning.append(odometry)
        began = time.perf_counter()
        estimates.append(slam.update(Reading.of_scan(ranges), Pose2D(*motion)).pose)
        seconds[k] = time.perf_counter() - began
    slam_position, slam_heading = _errors(estimates, start, truth)
    odometry_position, odometry_heading = _errors(dead_reckoning, start, truth)
    estimated = np.array(estimates[1:])[:, :2]
    frame = alignment(estimated, truth[:, :2])
    return DriveErrors(
        seed=seed,
        path_length=float(np.hypot(*np.diff(recorded.truth[:, :2], axis=0).T).sum()),
        slam_position=slam_position,
        slam_heading=slam_heading,
        odometry_position=odometry_position,
        odometry_heading=odometry_heading,
        slam_position_aligned=rms(np.hypot(*(frame.transform(estimated) - truth[:, :2]).T)),
        map_iou=map_iou(slam.belief.grid, setup.area, start),
        map_iou_aligned=map_iou(slam.belief.grid, setup.area, frame),
        milliseconds=1e3 * float(seconds.mean()),
        milliseconds_p99=1e3 * float(np.percentile(seconds, 99)),
    )


def _errors(poses: list[Pose2D], start: Pose2D, truth: np.ndarray) -> tuple[float, float]:
    """Return the root mean square errors [m, deg] of poses from the second on, given in the frame of the start."""
    distance, angle = pose_errors(compose_poses(np.array([start]), np.array(poses[1:])), truth)
    return rms(distance), float(np.degrees(rms(angle)))


def alignment(estimated: np.ndarray, true: np.ndarray) -> Pose2D:
    """Return the frame in which estimated positions come closest to true ones, shape (n, 2) [m], by least squares."""
    u, v = estimated - estimated.mean(axis=0), true - true.mean(axis=0)
    theta = math.atan2(float(np.sum(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])), float(np.sum(u * v)))
    x, y = true.mean(axis=0) - Pose2D(0.0, 0.0, theta).transform(estimated.mean(axis=0))
    return Pose2D(float(x), float(y), theta)


def main(
    world: str = "turtlebot3_world",
    robot: str = "turtlebot3_burger",
    physics: Literal["bullet", "kinematic"] = "bullet",
    slam: str = DEFAULT_SLAM,
    preset: str = "default",
    seeds: Count = 5,
    minutes: float = 5.0,
    tilt: float = 0.0,
    json_path: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
) -> None:
    """Measure SLAM on simulated drives.

    Args:
        world: library world, or path of a world file.
        robot: library robot, or path of a robot file.
        physics: simulator.
        slam: name of a SLAM, or `module:attribute` of your own.
        preset: of the SLAM's parameters.
        seeds: number of drives.
        minutes: length of each drive [min].
        tilt: pitch of the lidar, positive looking down [deg]; the SLAM takes it to be level.
        json_path: also write the results to this file.
    """
    if slam == "truth":
        raise SystemExit("error: slam 'truth' has no errors; choose one that estimates poses")
    params = load_robot(robot)
    mount = replace(params.lidar.mount, pitch=math.radians(tilt))
    params = replace(params, lidar=replace(params.lidar, mount=mount))
    setup = make_setup(load_world(world), params, physics)
    estimator = make_slam(slam, setup.robot.lidar, RESOLUTION, preset, setup.robot.odometry.noise)
    results = []
    print(f"{setup.robot.name} in {setup.world.name}, {physics} physics, {slam} {preset}, {minutes:g} min per drive")
    print("seed   path  |     position RMSE [m]      | heading RMSE [deg] |    map IoU")
    print("        [m]  |   slam (aligned) odometry  |   slam  odometry   |      (aligned)")
    for seed in range(seeds):
        results.append(evaluate(setup, record_drive(setup, seed, 60.0 * minutes), estimator, seed))
        print(_row(str(seed), results[-1:]))
    print(_row("med", results))
    if json_path is not None:
        json_path.write_text(json.dumps([result._asdict() for result in results], indent=2) + "\n")


def _row(name: str, results: list[DriveErrors]) -> str:
    """Return a line of the table, with medians over the drives."""
    columns = dict(zip(DriveErrors._fields, np.median(results, axis=0)))
    return (
        f"{name:>4}"
        " {path_length:6.1f}  | {slam_position:7.3f}   ({slam_position_aligned:.3f}) {odometry_position:9.3f}"
        "  | {slam_heading:7.2f} {odometry_heading:9.2f}  | {map_iou:.2f}   ({map_iou_aligned:.2f})"
    ).format(**columns)


if __name__ == "__main__":
    run_command(main)

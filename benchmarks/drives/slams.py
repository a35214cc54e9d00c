"""Benchmarks of SLAM accuracy on simulated drives, and with kidnapped robots.

The true pose controls the robots, so the route is equal for every SLAM. Errors are in the frame of the start pose.
"""

import itertools
import math
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from lidarnaut.benchmarks.drives.localization import MAX_POSITION_ERROR
from lidarnaut.benchmarks.drives.maps import Panel, draw_maps, wrong_cells
from lidarnaut.benchmarks.drives.recording import (
    PERIOD,
    RESOLUTION,
    Drive,
    Row,
    Setup,
    first_time,
    make_setup,
    medians,
    record,
    record_drive,
    right_since,
    run_each,
    track,
)
from lidarnaut.envs.command_line import Count
from lidarnaut.envs.estimation import Estimator
from lidarnaut.envs.logs import compose_poses, rms, trajectory_errors
from lidarnaut.envs.navigation import crop_to_known
from lidarnaut.envs.progress import Progress
from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.slam import SLAM_NAMES, base_name, make_slam
from lidarnaut.envs.tasks.coverage import map_iou
from lidarnaut.envs.worlds import load_world
from lidarnaut.envs.worlds.procedural import FAMILIES

DRIVES = (
    "explorebench_loop:turtlebot3_burger",
    "rmf_office_L1:turtlebot3_burger",
    "rmf_hotel_L1:turtlebot3_burger",
    "turtlebot3_house:turtlebot3_burger",
    "rmf_hotel_L1:tugbot",
    "tugbot_warehouse:tugbot",
)
"""Simulated drives as `WORLD:ROBOT`. Lidar ranges are 3.5 m (TurtleBot3 Burger) and 10 m (Tugbot)."""
HELD_OUT = (
    "aws_small_house",
    "aws_small_warehouse",
    "explorebench_corridor",
    "rmf_hotel_L1",
    "rrt_MTR",
    "rrt_house",
    "rooms:1",
    "maze:1",
)
"""Asymmetric test worlds for kidnapped robots, not used to tune relocalization."""


def compare_slams(
    slams: tuple[str, ...] = tuple(name for name in SLAM_NAMES if name != "truth"),
    drives: tuple[str, ...] = DRIVES,
    seeds: Count = 5,
    minutes: float = 10.0,
    physics: Literal["bullet", "kinematic"] = "kinematic",
    tilt: float = 0.0,
    picture: Path | None = None,
) -> list[Row]:
    """Measure the RMSE of SLAMs on simulated drives; results are medians over seeds.

    Args:
        slams: names of SLAMs, also with parameters as in `hector?preset=faithful`; `odometry` for raw odometry.
        drives: `WORLD:ROBOT`, names or paths.
        seeds: drives per world.
        minutes: duration of a drive [min].
        physics: simulator.
        tilt: lidar pitch, positive down, unknown to the SLAM [deg].
        picture: also plot the maps of the last drive to this file.
    """
    rows = []
    for name in drives:
        world, _, robot_name = name.partition(":")
        robot = load_robot(robot_name)
        lidar = replace(robot.lidar, mount=replace(robot.lidar.mount, pitch=math.radians(tilt)))
        setup = make_setup(load_world(world), replace(robot, lidar=lidar), physics)
        recorded = [record_drive(setup, seed, 60.0 * minutes) for seed in range(seeds)]
        walls, start = setup.area.walls, setup.world.spawns[0]
        panels = [Panel("Ground truth, and the path driven", walls, recorded[-1].truth)]
        for slam_name in Progress(slams, name, leave=False):
            slam = make_slam(slam_name, robot.lidar, RESOLUTION, odometry_noise=robot.odometry.noise)
            found = []
            for seed, drive in enumerate(recorded):
                exact = drive.at_true_poses() if base_name(slam_name) == "truth" else drive
                row, poses = measure_drive(setup, exact, slam, seed)
                found.append(row)
            title = f"{slam_name}: RMSE {row['translation_m']:.2f} m, map IoU {row['map_iou']:.2f}"
            grid = slam.belief.grid
            panels.append(Panel(title, grid, poses, wrong_cells(grid, start, walls), start))
            rows.append({"slam": slam_name, "data": name, **medians(found)})
        if picture is not None and name == drives[-1]:
            length = np.hypot(*np.diff(recorded[-1].truth[:, :2], axis=0).T).sum()
            note = f"{world}: {robot.name}, {robot.lidar.range_max:g} m lidar, {length:.0f} m in {minutes:g} minutes"
            draw_maps(picture, panels, crop_to_known(walls, margin=0), note)
    return rows


def measure_drive(setup: Setup, drive: Drive, slam: Estimator, seed: int) -> tuple[Row, np.ndarray]:
    """Run a SLAM along a recorded drive; return errors and times, and estimated poses in the world frame."""
    slam.reset(np.random.default_rng(seed).spawn(2)[1])
    tracked, start = track(slam, drive), setup.world.spawns[0]
    poses = compose_poses(np.array([start]), tracked["poses"])
    distance, angle = trajectory_errors(poses[1:], drive.truth[1:])
    row = {
        "translation_m": rms(distance),
        "rotation_deg": math.degrees(rms(angle)),
        "map_iou": map_iou(slam.belief.grid, setup.area, start),
        "ms_per_scan": 1e3 * float(tracked["seconds"].mean()),
        "p99_ms": 1e3 * float(np.percentile(tracked["seconds"], 99)),
    }
    return row, poses


def compare_kidnapped(
    slams: tuple[str, ...] = ("hector", "tinyslam", "graph", "gmapping"),
    worlds: tuple[str, ...] = HELD_OUT,
    seeds: Count = 5,
    minutes: float = 25.0,
    seconds: float = 180.0,
    jobs: Count = 1,
) -> list[Row]:
    """Count kidnapped robots that report being lost, that relocalize, and that end at a wrong pose without a report.

    Times are medians [s].

    Args:
        slams: names of SLAMs.
        worlds: library worlds, or `FAMILY:SEED`.
        seeds: robots per world.
        minutes: mapping time [min].
        seconds: driving time after the robot was moved [s].
        jobs: number of processes.
    """
    tasks = [(slam, world, k, minutes, seconds) for slam in slams for world in worlds for k in range(seeds)]
    outcomes = np.array(run_each(kidnap, tasks, jobs, "kidnapped robots"))
    rows = []
    for slam, world in itertools.product(slams, (*worlds, "all")):
        some = outcomes[[task[0] == slam and world in (task[1], "all") for task in tasks]]
        row: Row = {"slam": slam, "world": world, "robots": len(some)}
        for name, times in (("report_is_lost", some[:, 0]), ("relocalized", some[:, 1])):
            finite = times[np.isfinite(times)]
            row |= {name: len(finite), f"{name}_after_s": float(np.median(finite)) if len(finite) else None}
        rows.append(row | {"wrong_not_reported": int(some[:, 2].sum())})
    return rows


def kidnap(slam_name: str, world: str, seed: int, minutes: float, seconds: float) -> tuple[float, float, bool]:
    """Simulate a TurtleBot3 Burger that maps for `minutes`, is moved without odometry, and continues for `seconds`.

    Returns the time from the move until SLAM reports the robot lost [s], the time until the position stays correct [s],
    and whether the robot ends at a wrong position without a report. Times are inf if never.
    """
    family, _, number = world.partition(":")
    found = FAMILIES[family](int(number)) if family in FAMILIES else load_world(world)
    setup = make_setup(found, load_robot("turtlebot3_burger"), "kinematic")
    rngs = np.random.default_rng(seed).spawn(6)
    start, elsewhere = setup.world.spawns[0], setup.area.draw_pose(rngs[4])
    first = record(setup, start, rngs[0], rngs[1], 60.0 * minutes)
    drive = first.then(record(setup, elsewhere, rngs[2], rngs[3], seconds), len(first.ranges))
    slam = make_slam(slam_name, setup.robot.lidar, RESOLUTION, odometry_noise=setup.robot.odometry.noise)
    slam.reset(rngs[5])
    after = {name: values[len(first.ranges) :] for name, values in track(slam, drive).items()}
    poses, is_lost = compose_poses(np.array([start]), after["poses"]), after["is_lost"]
    errors = trajectory_errors(poses, drive.truth[len(first.ranges) :])[0]
    found_after = right_since(~is_lost & (errors <= MAX_POSITION_ERROR), PERIOD)
    return first_time(is_lost), found_after, bool(not is_lost[-1] and errors[-1] > MAX_POSITION_ERROR)

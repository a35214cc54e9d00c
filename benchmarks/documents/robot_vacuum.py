"""Robot vacuum with TinySLAM, driven by keyboard (Nguyen et al., 2025); see `docs/documents/robot_vacuum.md`."""

import math
from collections.abc import Iterator
from dataclasses import astuple, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from lidarnaut.benchmarks.documents.figures import Figure, figures_of
from lidarnaut.benchmarks.drives.maps import Panel, draw_maps
from lidarnaut.benchmarks.drives.recording import Drive, make_setup, random_goals, record, run_each
from lidarnaut.benchmarks.drives.slams import measure_drive
from lidarnaut.envs.navigation import crop_to_known
from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.slam import make_slam
from lidarnaut.envs.teleop import TURN_RATE
from lidarnaut.envs.worlds import load_world, save_map
from lidarnaut.envs.worlds.map_files import load_map

REPORT, BASE = "tinyslam?preset=robot_vacuum", "cell_type=base,unvisited=0.5,quality=0.2,raw_quality=0.1"
SLAMS = {
    "true poses": ("odometry", 0.05),
    "odometry": ("odometry", 0.05),
    "report": (REPORT, 0.1),
    "report, 0.05 m": (REPORT, 0.05),
    "report, 0.05 m, short blur": (f"{REPORT},blur=assign,hole_width=0.1", 0.05),
    "report, area": (f"{REPORT},occupancy_estimator=area", 0.1),
    "report, base": (f"{REPORT},{BASE}", 0.1),
    "default": ("tinyslam", 0.05),
    "default, bumper ignored": ("tinyslam", 0.05),
    "default, area": ("tinyslam?occupancy_estimator=area", 0.05),
    "default, base": (f"tinyslam?{BASE}", 0.05),
}
"""SLAM and map resolution [m] by the name of their parameters."""
PICTURED = ("report", "default")


def tour(setup: Any, simulator: Any, rng: np.random.Generator) -> Iterator[tuple[float, float]]:
    """Yield the keys of a person who watches the robot and drives it through the rooms, as signs of speed and turn."""
    for v, w in random_goals(setup, simulator, rng):
        yield np.sign(v), np.sign(w) if abs(w) >= 0.2 else 0.0


def bounce(setup: Any, simulator: Any, rng: np.random.Generator) -> Iterator[tuple[float, float]]:
    """Yield keys that drive straight into obstacles, back off and turn at random, as robot vacuums do."""
    while True:
        while not simulator.rows.reading(0).bumper:
            yield 1.0, 0.0
        yield from [(-1.0, 0.0)] * 5
        yield from [(0.0, 1.0 if rng.random() < 0.5 else -1.0)] * int(rng.uniform(5.0, 30.0))


KINDS = {
    "tour": (tour, 10.0, "create3"),
    "into furniture": (bounce, 20.0, "create3"),
    "into furniture, Burger": (bounce, 20.0, "turtlebot3_burger"),
}
"""Drivers, durations [min] and robots of the drives."""


def run_drive(kind: str, seed: int, pictures: Path | None, quick: bool) -> dict[str, float]:
    """Drive by keyboard, and run each SLAM along the drive; return its errors by name with unit.

    Commands are those of `lidarnaut-teleop`. The growing maps are drawn to the folder `pictures`, if given.
    """
    driver, minutes, robot_name = KINDS[kind]
    setup = make_setup(load_world("aws_small_house"), load_robot(robot_name), "bullet")
    robot, start = setup.robot, setup.world.spawns[0]

    def press(*sources: Any) -> Iterator[Any]:
        for v, w in driver(*sources):
            yield v * robot.max_v, w * min(robot.max_w, TURN_RATE)

    drive = record(setup, start, *np.random.default_rng(seed).spawn(2), 30.0 if quick else 60.0 * minutes, press)
    variants = {
        "true poses": drive.at_true_poses(),
        "default, bumper ignored": replace(drive, bumper=np.zeros_like(drive.bumper)),
    }
    errors, panels = {}, []
    for name, (slam_name, resolution) in SLAMS.items():
        slam = make_slam(slam_name, robot.lidar, resolution, odometry_noise=robot.odometry.noise)
        for scans in [len(drive.truth) // part for part in ((20, 6, 1) if name in PICTURED else (1,))]:
            part = Drive(*(each[:scans] for each in astuple(variants.get(name, drive))))
            row, poses = measure_drive(setup, part, slam, seed)
            panels += [Panel(f"{name}, {0.1 * scans:.0f} s", slam.belief.grid, poses, None, start)] * (name in PICTURED)
        with TemporaryDirectory() as folder:
            saved = load_map(save_map(slam.belief.grid, Path(folder) / "map.png", "scale")).data
        off, of = (poses - drive.truth)[-100:], f"{kind}, {name}:"
        drift = math.degrees(abs(np.mean(np.remainder(off[:, 2] + math.pi, 2.0 * math.pi)) - math.pi))
        errors[f"{of} map IoU"], errors[f"{of} yaw drift [deg]"] = row["map_iou"], drift
        errors[f"{of} position RMSE [m]"] = row["translation_m"]
        errors[f"{of} final error [m]"] = math.hypot(*off[-1, :2])
        errors[f"{of} cells changed by saving"] = float(np.count_nonzero(saved != slam.belief.grid.data))
    if pictures is not None:
        walls = crop_to_known(setup.area.walls, margin=0)
        draw_maps(pictures / "robot_vacuum.png", panels, walls, "aws_small_house, Create 3")
    return errors


def run(pictures: Path, runs: int | None, jobs: int, quick: bool) -> list[Figure]:
    """Tour a flat by keyboard, and drive into its furniture; measure the maps of `SLAMS`."""
    count = runs or (1 if quick else 4)
    tasks = [(kind, k, None if k or kind != "tour" else pictures, quick) for kind in KINDS for k in range(count)]
    done = run_each(run_drive, tasks, jobs, "drives")
    return [one for first in range(0, len(done), count) for one in figures_of(done[first : first + count], "{}")]

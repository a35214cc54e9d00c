"""Accuracy of AMCL in known worlds and on the log of a real robot."""

import math
import os
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np

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
    right_since,
    run_each,
    track,
)
from lidarnaut.envs.arguments import choose_robot
from lidarnaut.envs.command_line import Count
from lidarnaut.envs.geometry import OCCUPIED, OccupancyGrid, Pose2D
from lidarnaut.envs.localization import PRESETS, Amcl, AmclParams, load_preset
from lidarnaut.envs.logs import Log, load_log, rms, trajectory_errors
from lidarnaut.envs.robots import LidarParams
from lidarnaut.envs.slam import KnownPoses, TinySlamParams
from lidarnaut.envs.tasks.goals import known_map
from lidarnaut.envs.worlds import load_world
from lidarnaut.envs.worlds.world import box, edges

WORLDS = ("turtlebot3_world", "turtlebot3_house", "tugbot_warehouse")
TRACKING_TIME, KIDNAPPED_AT, RECOVERY_TIME = 60.0, 20.0, 90.0
"""Durations of driving [s]: for tracking or global localization, before a kidnapping, and after it."""
MAX_POSITION_ERROR, MAX_HEADING_ERROR = 0.5, math.radians(20.0)
"""Maximum errors of a correct pose estimate [m, rad]."""
MIN_CORRECT_TIME = 5.0
"""A localization succeeds if the pose estimate is correct for at least this time until the end of the drive [s]."""
CUPBOARD_DISTANCES, CUPBOARD_LENGTHS, CUPBOARD_DEPTHS = (1.5, 4.0), (0.8, 2.0), (0.4, 0.6)
"""Cupboards that the map lacks: distance from the start, length and depth [m]."""
START_STD = (0.05, 0.05, 0.05)
"""Standard deviations of AMCL's initial pose (x, y, heading) in simulated worlds [m, m, rad]."""
LOG_START_STD = (0.1, 0.1, 0.05)
"""Standard deviations of AMCL's initial pose (x, y, heading) on the log of a real robot [m, m, rad]."""
LOG_SEEDS = range(100, 105)
SHARE_OF_HITS = 16
"""A map cell is occupied if at least this percentage of the lidar beams that reach it end in it (as in Hector SLAM)."""
HIT_COUNTS = TinySlamParams(
    resolution=0.05,
    map_width=60.0,
    map_height=60.0,
    hole_width=0.0,
    occupied_prob=1.0,
    empty_prob=0.0,
    quality=1.0,
    raw_quality=1.0,
    skip_exceeding=True,
)
"""Mapping parameters: each cell stores the percentage of beams that end in it, among those that reach it."""
NAV2_PROB = replace(PRESETS["nav2"], sensor="likelihood_field_prob")
NO_RELOCALIZATION = replace(PRESETS["default"], relocalize=False)
FILTERS = {
    "nav2 likelihood_field": PRESETS["nav2"],
    "nav2 likelihood_field_prob": NAV2_PROB,
    "nav2 likelihood_field_prob, 2000 particles": replace(NAV2_PROB, min_particles=2000),
    "nav2 beam": replace(PRESETS["nav2"], sensor="beam", max_range=30.0),
    "default": NO_RELOCALIZATION,
    "default, 2000 particles, all beams": replace(NO_RELOCALIZATION, min_particles=2000, max_beams=180, squash=9.0),
}
"""Parameters of AMCL variants compared on the log of a real robot, by name. Relocalization is off."""


def localize(
    amcl: Amcl, grid: OccupancyGrid, drive: Drive, seed: int, start_std: tuple[float, float, float] | None
) -> dict[str, np.ndarray]:
    """Run AMCL on a known map along a recorded drive; return poses, lost flags and other values per scan, by name.

    `start_std` are standard deviations of the initial pose [m, m, rad]; None for global localization.
    """
    start = None if start_std is None else Pose2D(*drive.truth[0].tolist())
    covariance = None if start_std is None else np.diag(np.square(start_std))
    amcl.reset(np.random.default_rng(seed), start, grid, covariance)
    return track(amcl, drive, "is_corrected", "num_particles")


@lru_cache(maxsize=4)
def load_known_world(name: str, physics: str = "kinematic") -> Setup:
    """Load a library world and its default robot, for localization on the true map.

    The map is offset by half a cell, because walls of library worlds lie on cell borders.
    """
    world, half = load_world(name), 0.5 * RESOLUTION
    bounds = np.array(world.bounds) + (-half, -half, half, half)
    return make_setup(replace(world, bounds=tuple(bounds.tolist())), choose_robot(None, name), physics)


def record_from_anywhere(setup: Setup, seed: np.random.SeedSequence, duration: float, cupboards: int = 0) -> Drive:
    rng_simulator, rng_driver = map(np.random.default_rng, seed.spawn(2))
    start = setup.area.draw_pose(rng_driver)
    return record(add_cupboards(setup, start, cupboards, rng_driver), start, rng_simulator, rng_driver, duration)


def add_cupboards(setup: Setup, start: Pose2D, count: int, rng: np.random.Generator) -> Setup:
    """Add cupboards around a start pose; each leaves the robot at least 90 % of the area that it reached before."""
    while count > 0:
        area, world = setup.area, replace(setup.world, spawns=(start,))
        centres = area.walls.centers(np.argwhere(area.traversable))
        low, high = CUPBOARD_DISTANCES
        distances = np.hypot(*(centres - start[:2]).T)
        x, y = rng.choice(centres[(distances >= low) & (distances <= high)])
        size = rng.uniform(*CUPBOARD_LENGTHS), rng.uniform(*CUPBOARD_DEPTHS)
        sides = edges(box(x, y, *size, rng.integers(2) * math.pi / 2))
        changed = make_setup(replace(world, segments=np.vstack([world.segments, sides])), setup.robot, setup.physics)
        if changed.area.traversable.sum() >= 0.9 * area.traversable.sum():
            setup, count = changed, count - 1
    return setup


def compare_amcl(
    runs: Count = 100,
    jobs: Count = 2,
    worlds: tuple[str, ...] = WORLDS,
    physics: Literal["kinematic", "bullet"] = "kinematic",
    preset: str = "default",
    cupboards: int = 0,
) -> list[Row]:
    """Measure AMCL in known worlds: pose tracking, global localization and kidnapped robots.

    Args:
        runs: number of seeds per world.
        jobs: number of processes.
        worlds: library worlds.
        physics: simulator.
        preset: parameter preset of AMCL.
        cupboards: number of cupboards that the map lacks, near each start.
    """
    rows = []
    for world in worlds:
        tasks = [(world, preset, physics, seed, cupboards) for seed in range(runs)]
        found = run_each(run, tasks, jobs, world)
        done = {key: np.array([one[key] for one in found]) for key in found[0]}
        row: Row = {"world": world} | {f"tracking_rmse_{unit}": rms(done[f"tracking_{unit}"]) for unit in ("m", "deg")}
        row |= {f"tracking_worst_run_{unit}": float(done[f"tracking_{unit}"].max()) for unit in ("m", "deg")}
        row["tracking_max_m"] = float(done["tracking_max_m"].max())
        for what in ("global_after", "kidnapped_after", "kidnapped_noticed_after"):
            row |= {f"{what}_median_s": time_quantile(done[what], 0.5), f"{what}_p90_s": time_quantile(done[what], 0.9)}
        for what in ("global_after", "kidnapped_after"):
            row[what.replace("after", "success")] = float(np.isfinite(done[what]).mean())
        rows.append(row | {name: float(done[name].mean()) for name in ("confident_and_wrong", "lost_while_right")})
    return rows


def time_quantile(times: Sequence[float], share: float) -> float | None:
    """Return a quantile of event times, which are inf for events that never happened; None if the quantile is inf."""
    if math.isinf(np.quantile(times, share, method="higher")):
        return None
    return float(np.quantile(np.nan_to_num(times), share))


def run(world: str, preset: str, physics: str, seed: int, cupboards: int) -> Row:
    """Measure AMCL in one world with one seed: pose tracking, global localization and a kidnapped robot."""
    setup = load_known_world(world, physics)
    grid, amcl = known_map(setup.area), Amcl(setup.robot.lidar, load_preset(preset))
    first, second = np.random.SeedSequence(seed).spawn(2)
    drive = record_from_anywhere(setup, first, TRACKING_TIME, cupboards)
    elsewhere = record_from_anywhere(setup, second, RECOVERY_TIME, cupboards)

    tracked = localize(amcl, grid, drive, seed, START_STD)
    distance, angle = trajectory_errors(tracked["poses"], drive.truth)

    found = localize(amcl, grid, drive, seed, None)
    is_right = _is_right(found["poses"], drive.truth)

    scans = round(KIDNAPPED_AT / PERIOD)
    kidnapped = drive.then(elsewhere, scans)
    again = localize(amcl, grid, kidnapped, seed, START_STD)
    is_right_again, is_lost_again = _is_right(again["poses"], kidnapped.truth)[scans:], again["is_lost"][scans:]
    wrong = np.concatenate([~is_right & ~found["is_lost"], ~is_right_again & ~is_lost_again])
    return {
        "tracking_m": rms(distance),
        "tracking_max_m": float(distance.max()),
        "tracking_deg": math.degrees(rms(angle)),
        "lost_while_right": float(np.mean(tracked["is_lost"] & _is_right(tracked["poses"], drive.truth))),
        "global_after": right_since(is_right, MIN_CORRECT_TIME),
        "kidnapped_after": right_since(is_right_again, MIN_CORRECT_TIME),
        "kidnapped_noticed_after": first_time(is_lost_again),
        "confident_and_wrong": float(np.mean(wrong)),
    }


def _is_right(poses: np.ndarray, truth: np.ndarray) -> np.ndarray:
    distance, angle = trajectory_errors(poses, truth)
    return (distance <= MAX_POSITION_ERROR) & (angle <= MAX_HEADING_ERROR)


def compare_on_log(log: Path | None = None) -> list[Row]:
    """Compare AMCL variants on the log of a real robot; results are medians over seeds.

    Args:
        log: log file with reference poses (array `corr`), used to build the map; by default
            `intel/scans_2725.npz`, of the Intel Research Lab, in the folder LIDARNAUT_DATA.
    """
    if log is None and not (data := os.environ.get("LIDARNAUT_DATA")):
        raise ValueError("no log: pass --log FILE, or set LIDARNAUT_DATA to the folder of intel/scans_2725.npz")
    read, drive = load_reference(log or Path(data, "intel", "scans_2725.npz"))
    grid = reference_map(read.lidar, drive)
    rows = []
    for name, params in FILTERS.items():
        seeds = LOG_SEEDS[:1] if params.sensor == "beam" else LOG_SEEDS
        found = [measure_filter(drive, read.lidar, grid, params, seed) for seed in seeds]
        rows.append({"filter": name, **medians(found)})
    return rows


def load_reference(path: Path, num_scans: int | None = None) -> tuple[Log, Drive]:
    """Return the first `num_scans` scans of a log, and a drive with reference poses relative to the first pose."""
    log = load_log(path)
    log = replace(log, scan_rows=log.scan_rows[:num_scans], ranges=log.ranges[:num_scans])
    with np.load(path) as arrays:
        corrected = arrays["corr"][log.scan_rows]
    origin = Pose2D(*corrected[0])
    reference = np.array([origin.between(Pose2D(*row)) for row in corrected.tolist()])
    return log, Drive(log.ranges, np.array(list(log.motions())), reference, np.zeros(len(reference), dtype=bool))


def reference_map(lidar: LidarParams, drive: Drive) -> OccupancyGrid:
    """Build an occupancy grid from the scans of a drive at its reference poses."""
    mapper = KnownPoses(lidar, HIT_COUNTS)
    mapper.reset(np.random.default_rng(0))
    track(mapper, drive.at_true_poses())
    grid = mapper.belief.grid
    data = np.where(grid.data >= SHARE_OF_HITS, OCCUPIED, np.minimum(grid.data, 0)).astype(np.int8)
    return OccupancyGrid(data, grid.resolution, grid.origin)


def measure_filter(drive: Drive, lidar: LidarParams, grid: OccupancyGrid, params: AmclParams, seed: int) -> Row:
    done = localize(Amcl(lidar, params), grid, drive, seed, LOG_START_STD)
    distance, angle = trajectory_errors(done["poses"], drive.truth)
    return {
        "position_rmse_m": rms(distance),
        "position_median_m": float(np.median(distance)),
        "position_max_m": float(distance.max()),
        "heading_rmse_deg": math.degrees(rms(angle)),
        "update_us": 1e6 * float(np.median(done["seconds"][done["is_corrected"]])),
        "particles": float(np.mean(done["num_particles"][done["is_corrected"]])),
        "lost_share": float(np.mean(done["is_lost"])),
    }

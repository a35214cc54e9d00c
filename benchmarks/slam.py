"""All SLAMs on the log of a real robot and on simulated drives: `python -m benchmarks.slam --json FILE`.

The log is the Intel Research Lab's, by its relation error (Kuemmerle et al., On measuring the accuracy of SLAM
algorithms, 2009); without `--log` it is left out. On drives a robot is driven by ground truth to random goals, so that
the route, the same for every SLAM, does not depend on estimates; errors are root mean squares over all scans against
ground truth, in the frame of the start. `--slams hector odometry` compares with the robot's own odometry.
"""

import json
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro
from rich.table import Table

from benchmarks.recorded_drives import RESOLUTION, Drive, Setup, make_setup, record_drive, track
from envs.command_line import Count, make_console, run_command
from envs.estimation import Estimator
from envs.logs import compose_poses, load_log, load_relations, pose_errors, rms
from envs.logs.relations import load_mask
from envs.logs.runs import measure, replay
from envs.progress import Progress
from envs.robots import RobotParams, load_robot
from envs.slam import SLAM_NAMES, SLAMS, make_slam
from envs.tasks.coverage import map_iou
from envs.worlds import load_world

DRIVES = (
    "explorebench_loop:turtlebot3_burger",
    "rmf_office_L1:turtlebot3_burger",
    "rmf_hotel_L1:turtlebot3_burger",
    "turtlebot3_house:turtlebot3_burger",
    "rmf_hotel_L1:tugbot",
    "tugbot_warehouse:tugbot",
)
"""Worlds and robots: lidars of 3.5 m, and of 10 m."""
COLUMNS = {
    "slam": "SLAM",
    "data": "data",
    "translation_m": "translation [m]",
    "rotation_deg": "rotation [deg]",
    "unambiguous_m": "unambiguous [m]",
    "online_m": "online [m]",
    "map_iou": "map IoU",
    "ms_per_scan": "ms per scan",
    "p99_ms": "99 % [ms]",
}
"""Keys of the rows, and what they are called in the table."""
Row = dict[str, Any]


def log_rows(log_path: Path, relations_path: Path, slams: tuple[str, ...], seeds: int) -> Iterator[Row]:
    """Yield the medians over seeds of each SLAM on a log with its preset `intel`."""
    log, relations = load_log(log_path), {"error": load_relations(relations_path)}
    mask = relations_path.parent / "unambiguous_relations.npy"
    if mask.exists():
        relations["error_unambiguous"] = relations["error"][load_mask(mask, len(relations["error"]))]
    for name in Progress(slams, log_path.stem, leave=False):
        params = SLAMS[name].load("intel")
        slam = make_slam(name, log.lidar, params.resolution, params)
        runs = [measure(log, slam, name, seed, replay(log, slam, seed), relations) for seed in range(seeds)]
        final = np.median([(run.final_error.translation, run.final_error.rotation) for run in runs], axis=0)
        row = {"slam": name, "data": log_path.stem, "translation_m": final[0], "rotation_deg": final[1]}
        if mask.exists():
            row["unambiguous_m"] = np.median([run.final_error_unambiguous.translation for run in runs])
        row["online_m"] = np.median([run.error.translation for run in runs])
        row["ms_per_scan"] = np.median([run.milliseconds for run in runs])
        yield row | {"p99_ms": np.median([run.milliseconds_p99 for run in runs])}


def measure_drive(setup: Setup, drive: Drive, slam: Estimator, seed: int) -> dict[str, float]:
    """Run a SLAM along a drive that began at the first spawn; return what is measured by keys of `COLUMNS`."""
    slam.reset(np.random.default_rng(seed).spawn(2)[1])
    tracked, start = track(slam, drive), setup.world.spawns[0]
    distance, angle = pose_errors(compose_poses(np.array([start]), tracked.poses[1:]), drive.truth[1:])
    return {
        "translation_m": rms(distance),
        "rotation_deg": math.degrees(rms(angle)),
        "online_m": rms(distance),
        "map_iou": map_iou(slam.belief.grid, setup.area, start),
        "ms_per_scan": 1e3 * float(tracked.seconds.mean()),
        "p99_ms": 1e3 * float(np.percentile(tracked.seconds, 99)),
    }


def drive_rows(
    name: str, slams: tuple[str, ...], seeds: int, minutes: float, physics: str, preset: str, tilt: float
) -> Iterator[Row]:
    """Yield the medians over drives of each SLAM in `WORLD:ROBOT`."""
    world, _, robot = name.partition(":")
    setup = make_setup(load_world(world), tilted(load_robot(robot), tilt), physics)
    drives = [record_drive(setup, seed, 60.0 * minutes) for seed in range(seeds)]
    for slam_name in Progress(slams, name, leave=False):
        slam = make_slam(slam_name, setup.robot.lidar, RESOLUTION, preset, setup.robot.odometry.noise)
        found = [measure_drive(setup, each, slam, seed) for seed, each in enumerate(drives)]
        medians = {key: float(np.median([one[key] for one in found])) for key in found[0]}
        yield {"slam": slam_name, "data": name, **medians}


def tilted(robot: RobotParams, tilt: float) -> RobotParams:
    """Return a robot whose lidar looks down by an angle [deg]."""
    mount = replace(robot.lidar.mount, pitch=math.radians(tilt))
    return replace(robot, lidar=replace(robot.lidar, mount=mount))


def main(
    slams: tuple[str, ...] = tuple(name for name in SLAM_NAMES if name != "truth"),
    drives: tuple[str, ...] = DRIVES,
    log: Path | None = None,
    relations: Path | None = None,
    seeds: Count = 5,
    minutes: float = 10.0,
    physics: Literal["bullet", "kinematic"] = "kinematic",
    preset: str = "default",
    tilt: float = 0.0,
    json_path: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
) -> None:
    """Measure, and print a table.

    Args:
        slams: names of SLAMs.
        drives: `WORLD:ROBOT`, each from the library or paths of files.
        log: log of a real robot.
        relations: its hand-verified relations.
        seeds: drives in each world, and runs on the log.
        minutes: length of each drive [min].
        physics: simulator of the drives.
        preset: of the parameters of the SLAMs on the drives.
        tilt: pitch of the lidar, positive looking down [deg]; the SLAM takes it to be level.
        json_path: also write the rows to this file.
    """
    if (log is None) != (relations is None):
        raise SystemExit("error: --log and --relations go together")
    rows: list[Row] = []
    if log is not None and relations is not None:
        rows += log_rows(log, relations, slams, seeds)
    for name in drives:
        rows += drive_rows(name, slams, seeds, minutes, physics, preset, tilt)
    table = Table(*COLUMNS.values())
    for row in rows:
        values = [row.get(key, "") for key in COLUMNS]
        table.add_row(*(value if isinstance(value, str) else f"{value:.3f}" for value in values))
    make_console().print(table)
    if json_path is not None:
        json_path.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    run_command(main)

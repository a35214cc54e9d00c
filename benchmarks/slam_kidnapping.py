"""Kidnapped robots: `python -m benchmarks.slam_kidnapping`.

A robot maps a library world for some minutes, and is then put down elsewhere in it, unnoticed. Counted is whether the
SLAM says that it is lost, and whether it finds its pose again. Errors are against ground truth in the frame of the
start: what the map itself is off is part of them.
"""

from typing import NamedTuple

import numpy as np
from rich.table import Table

from benchmarks.parallel import run_each
from benchmarks.recorded_drives import PERIOD, RESOLUTION, make_setup, record, track
from envs.command_line import Count, make_console, run_command
from envs.logs import compose_poses, pose_errors
from envs.robots import load_robot
from envs.slam import make_slam
from envs.worlds import load_world

FOUND = 0.5
"""Position error up to which the robot has found its pose again [m]."""


class Outcome(NamedTuple):
    """What became of one kidnapped robot."""

    lost_after: float
    """Time until the SLAM said that it was lost [s]; infinite if it never did."""
    found_after: float
    """Time until its position was right, and stayed so, without `is_lost` [s]; infinite if it never was."""
    is_wrong: bool
    """Whether it ends without `is_lost` at a wrong position."""


def kidnap(slam_name: str, world: str, robot: str, seed: int, minutes: float, seconds: float) -> Outcome:
    """Map a world for some minutes, move the robot, and go on for some seconds."""
    setup = make_setup(load_world(world), load_robot(robot), "kinematic")
    rngs = np.random.default_rng(seed).spawn(6)
    start, elsewhere = setup.world.spawns[0], setup.area.draw_pose(rngs[4])
    first = record(setup, start, rngs[0], rngs[1], 60.0 * minutes)
    drive = first.then(record(setup, elsewhere, rngs[2], rngs[3], seconds), len(first.ranges))
    slam = make_slam(slam_name, setup.robot.lidar, RESOLUTION, odometry_noise=setup.robot.odometry.noise)
    slam.reset(rngs[5])
    tracked, after = track(slam, drive), slice(len(first.ranges), None)
    estimated = compose_poses(np.array([start]), tracked.poses[after])
    is_lost, errors = tracked.is_lost[after], pose_errors(estimated, drive.truth[after])[0]
    is_right = ~is_lost & (errors <= FOUND)
    wrong = np.flatnonzero(~is_right)
    found = 0.0 if len(wrong) == 0 else PERIOD * (wrong[-1] + 1) if wrong[-1] < len(is_right) - 1 else np.inf
    told = np.flatnonzero(is_lost)
    return Outcome(PERIOD * told[0] if len(told) else np.inf, found, bool(not is_lost[-1] and errors[-1] > FOUND))


def main(
    slams: tuple[str, ...] = ("hector", "tinyslam", "graph", "gmapping"),
    worlds: tuple[str, ...] = ("turtlebot3_house", "rmf_office_L1", "aws_bookstore", "explorebench_loop"),
    robot: str = "turtlebot3_burger",
    seeds: Count = 5,
    minutes: float = 10.0,
    seconds: float = 90.0,
    jobs: Count = 1,
) -> None:
    """Measure, and print a table.

    Args:
        slams: names of SLAMs.
        worlds: library worlds.
        robot: library robot.
        seeds: robots that are kidnapped in each world.
        minutes: mapping before [min].
        seconds: driving afterwards [s].
        jobs: processes.
    """
    tasks = [(slam, world, robot, k, minutes, seconds) for slam in slams for world in worlds for k in range(seeds)]
    outcomes = run_each(kidnap, tasks, jobs, desc="kidnapped robots")
    table = Table("SLAM", "world", "report is_lost", "after [s]", "relocalized", "after [s]", "wrong, not reported")
    for slam in slams:
        for world in (*worlds, "all"):
            some = [o for task, o in zip(tasks, outcomes) if task[0] == slam and world in (task[1], "all")]
            table.add_row(slam, world, *_cells(some), end_section=world == "all")
    make_console().print(table)


def _cells(outcomes: list[Outcome]) -> list[str]:
    cells = []
    for times in ([o.lost_after for o in outcomes], [o.found_after for o in outcomes]):
        finite = [time for time in times if np.isfinite(time)]
        cells += [f"{len(finite)} of {len(times)}", f"{np.median(finite):.0f}" if finite else ""]
    return [*cells, str(sum(o.is_wrong for o in outcomes))]


if __name__ == "__main__":
    run_command(main)

"""What planning costs on the whole map of a world: `python -m benchmarks.navigation`.

How surely and how fast the classic policies get to goals is measured by `evaluate.py --id lidarnaut/Navigate-v0`.
"""

import json as json_format
import timeit
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from envs.command_line import make_console, run_command
from envs.core import LidarEnv
from envs.geometry.polyline import lengths_along
from envs.navigation import (
    CostmapParams,
    LayeredCostmap,
    is_path_valid,
    make_costmap,
    plan_path,
    smooth_path,
    travel_field,
)
from envs.tasks.goals import known_map
from envs.tasks.navigate import Navigate
from envs.worlds import explorable_area

WORLDS = ("turtlebot3_house", "tugbot_warehouse")
REPEATS = 15
"""Each cost is the least of so many runs: other work of the machine only adds to it."""


def _best(work: Callable[[], object], repeats: int = REPEATS) -> float:
    """Return the least wall-clock time of some work [us], after one run that compiles it."""
    work()
    return 1e6 * min(timeit.repeat(work, number=1, repeat=repeats))


def planning_costs(world: str) -> dict[str, Any]:
    """Measure what planning costs on the whole map of a world, on one core."""
    env = LidarEnv(Navigate, world=world, physics="kinematic")
    drawn, robot = env.task.draw_world(None, np.random.default_rng(0)), env.robot
    area = explorable_area(drawn, robot, env.task.map_resolution)
    grid = known_map(area)
    params = CostmapParams(robot.radius + 0.03, robot.radius + 0.48, 4.0)
    costmap = make_costmap(grid, params)
    layers = LayeredCostmap(grid, params)
    rng = np.random.default_rng(0)
    # The two cells of this map that are farthest from each other: farthest from anywhere, then farthest from there.
    ends = [drawn.spawns[0][:2]]
    for _ in range(2):
        field = travel_field(costmap, ends[-1])
        assert field is not None
        travel = np.where(field.travel == field.travel.max(), -1, field.travel)[1:-1, 1:-1]
        ends.append(tuple(grid.centers(np.array(np.unravel_index(travel.argmax(), travel.shape)))))
    across = plan_path(costmap, ends[1], ends[2])
    assert across is not None
    pose = area.draw_pose(rng)
    ranges = rng.uniform(0.5, robot.lidar.range_max, robot.lidar.num_beams).astype(np.float32)

    def scan() -> None:
        layers.update(pose, ranges, robot.lidar)
        _ = layers.costmap

    pairs = [(area.draw_pose(rng)[:2], area.draw_pose(rng)[:2]) for _ in range(100)]
    random = [_best(lambda a=a, b=b: plan_path(costmap, a, b, tolerance=0.15), 3) for a, b in pairs]
    return {
        "cells": grid.data.size,
        "across_m": float(lengths_along(across)[-1]),
        "astar_across_us": _best(lambda: plan_path(costmap, ends[1], ends[2])),
        "astar_random_median_us": float(np.median(random)),
        "astar_random_p95_us": float(np.percentile(random, 95)),
        "smooth_across_us": _best(lambda: smooth_path(costmap, across)),
        "is_path_valid_us": _best(lambda: is_path_valid(costmap, across)),
        "inflate_whole_map_us": _best(lambda: make_costmap(grid, params)),
        "take_a_scan_us": _best(scan),
    }


def table(results: dict[str, dict[str, Any]]) -> Table:
    """Lay costs out, a column per world."""
    shown = Table("measure", *results)
    for name in next(iter(results.values())):
        shown.add_row(name, *(f"{result[name]:,.6g}" for result in results.values()))
    return shown


def main(worlds: tuple[str, ...] = WORLDS, json: Path | None = None) -> None:
    """Measure what planning costs, on one core.

    Args:
        worlds: Library worlds.
        json: Also write the costs to this file, as {world: {cost: value}}.
    """
    results = {world: planning_costs(world) for world in worlds}
    make_console().print(table(results))
    if json is not None:
        json.write_text(json_format.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    run_command(main)

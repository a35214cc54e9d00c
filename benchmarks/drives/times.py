"""Benchmarks of the processor times of path planning and of AMCL."""

import itertools
import timeit
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lidarnaut.benchmarks.drives.localization import START_STD, load_known_world, localize, record_from_anywhere
from lidarnaut.benchmarks.drives.recording import PERIOD, RESOLUTION, Row
from lidarnaut.envs.arguments import choose_robot
from lidarnaut.envs.geometry.lines import lengths_along
from lidarnaut.envs.localization import PRESETS, Amcl
from lidarnaut.envs.navigation import (
    CostmapParams,
    PlanningMap,
    PlanningParams,
    is_path_valid,
    make_costmap,
    plan_path,
    smooth_path,
    travel_field,
)
from lidarnaut.envs.tasks.goals import known_map
from lidarnaut.envs.worlds import explorable_area, load_world

REPEATS = 5
USED_SCANS = 0, 1, 2, 4, 8, 16, -1
"""Scans of global localization whose update times are shown, by number of earlier used scans."""


def _least(work: Callable[[], object], repeats: int = 15) -> float:
    work()
    return 1e6 * min(timeit.repeat(work, number=1, repeat=repeats))


def time_planning(worlds: tuple[str, ...] = ("turtlebot3_house", "tugbot_warehouse")) -> list[Row]:
    """Measure path planning and costmap updates on the complete map of a world [us], on one core.

    Args:
        worlds: library worlds.
    """
    return [planning_costs(world) for world in worlds]


def planning_costs(name: str) -> Row:
    world, robot = load_world(name), choose_robot(None, name)
    area = explorable_area(world, robot, RESOLUTION)
    grid = known_map(area)
    params = CostmapParams(robot.radius + 0.03, robot.radius + 0.48, 4.0)
    costmap, planning = make_costmap(grid, params), PlanningMap(robot, grid.resolution, PlanningParams(cell=0.05))
    planning.update(grid, None)
    rng = np.random.default_rng(0)
    # Find a distant pair of cells.
    ends = [world.spawns[0][:2]]
    for _ in range(2):
        field = travel_field(costmap, ends[-1])
        travel = np.where(field.travel == field.travel.max(), -1, field.travel)[1:-1, 1:-1]
        ends.append(tuple(grid.centers(np.array(np.unravel_index(travel.argmax(), travel.shape)))))
    across = plan_path(costmap, ends[1], ends[2])
    pose = area.draw_pose(rng)
    ranges = rng.uniform(0.5, robot.lidar.range_max, robot.lidar.num_beams).astype(np.float32)
    pairs = [(area.draw_pose(rng)[:2], area.draw_pose(rng)[:2]) for _ in range(100)]
    random = [_least(lambda a=a, b=b: plan_path(costmap, a, b, tolerance=0.15), 3) for a, b in pairs]
    return {
        "world": name,
        "cells": grid.data.size,
        "across_m": float(lengths_along(across)[-1]),
        "astar_across_us": _least(lambda: plan_path(costmap, ends[1], ends[2])),
        "astar_random_median_us": float(np.median(random)),
        "astar_random_p95_us": float(np.percentile(random, 95)),
        "smooth_across_us": _least(lambda: smooth_path(costmap, across)),
        "is_path_valid_us": _least(lambda: is_path_valid(costmap, across)),
        "inflate_whole_map_us": _least(lambda: make_costmap(grid, params)),
        "take_a_scan_us": _least(lambda: (planning.integrate(pose, ranges, robot.lidar), planning.layer(0, pose))),
    }


def time_amcl() -> list[Row]:
    """Measure the time of an AMCL update [us] by number of particles, and during global localization."""
    house = load_known_world("turtlebot3_house")
    lidar, grid = replace(house.robot.lidar, range_max=15.0), known_map(house.area)
    setup = house._replace(robot=replace(house.robot, lidar=lidar))
    drive, spent = record_from_anywhere(setup, np.random.SeedSequence(0), 30.0), dict[tuple[int, str], list[float]]()
    for n, sensor in [*itertools.product((1000, 2000), ("likelihood_field", "likelihood_field_prob"))] * REPEATS:
        every_scan = {"update_min_d": 0.0, "update_min_a": 0.0}
        params = replace(PRESETS["nav2"], min_particles=n, max_particles=n, sensor=sensor, **every_scan)
        seconds = localize(Amcl(lidar, params), grid, drive, 0, START_STD)["seconds"]
        spent.setdefault((n, sensor), []).append(1e6 * float(np.median(seconds[20:])))
    rows: list[Row] = [
        {"what": sensor, "particles": n, "update_us": float(np.median(times))} for (n, sensor), times in spent.items()
    ]
    drive, params = record_from_anywhere(house, np.random.SeedSequence(1), 30.0), PRESETS["default"]
    amcl = Amcl(house.robot.lidar, params)
    localize(amcl, grid, drive, 1, None)  # compiles
    done = localize(amcl, grid, drive, 1, None)
    used, weighted = np.flatnonzero(done["is_corrected"]), [params.most_particles, *done["num_particles"]]
    for k in (k for k in USED_SCANS if k < len(used)):
        what = f"global localization, scan {k % len(used) + 1}, {PERIOD * used[k]:.1f} s"
        row = {"what": what, "particles": int(weighted[used[k]]), "update_us": 1e6 * float(done["seconds"][used[k]])}
        rows.append(row)
    return rows

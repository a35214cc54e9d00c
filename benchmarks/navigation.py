"""How surely and how fast the classic navigator gets to random goals on known maps.

Each goal is an episode of `lidarnaut/Navigate-v0`: a random start, a random goal, AMCL with an initial pose that is a
little wrong, and `baselines.navigation.GoalDriver`. A goal counts as reached without collision only if the robot's
true position came within 0.3 m of it and nothing was touched before that. Run `python -m benchmarks.navigation --help`.
"""

import json as json_format
import math
from collections import Counter
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.table import Table

from baselines.episode import Episode, run_episode
from baselines.navigation import GoalDriver, MapNavigatorParams
from benchmarks.parallel import run_each
from benchmarks.simulation import measure
from envs.command_line import Count, make_console, run_command
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


@lru_cache(maxsize=4)
def _environment(world: str, physics: str, localizer: str) -> LidarEnv:
    """Return the environment of a process, made once."""
    return LidarEnv(Navigate, world=world, physics=physics, localizer=localizer)


class Drive(NamedTuple):
    """An episode, and what its policy says of it."""

    seed: int
    episode: Episode
    recoveries: int

    @property
    def is_success(self) -> bool:
        """Whether the goal was reached without a collision."""
        return self.episode.end_reason == "reached" and self.episode.collisions == 0

    @property
    def geodesic_distance(self) -> float:
        """True geodesic distance to the goal at the start [m]."""
        return float(self.episode.course.of("way_to_goal")[0])


def _drive(world: str, physics: str, localizer: str, local_planner: str, seed: int) -> Drive:
    driver = GoalDriver(MapNavigatorParams(local_planner=local_planner))
    episode = run_episode(_environment(world, physics, localizer), driver, seed)
    return Drive(seed, episode, driver.navigator.num_recoveries if driver.navigator else 0)


def summary(drives: list[Drive], max_v: float) -> dict[str, Any]:
    """Summarise at least one drive; times are NaN where no goal was reached, `max_v` is the robot's limit [m/s]."""
    reached = [d for d in drives if d.is_success]
    times = [d.episode.duration for d in reached] or [math.nan]
    shortest = sum(d.geodesic_distance for d in reached)
    return {
        "goals": len(drives),
        "reached_without_collision_percent": 100.0 * len(reached) / len(drives),
        "end_reasons": dict(Counter(d.episode.end_reason for d in drives)),
        "with_collision": sum(d.episode.collisions > 0 for d in drives),
        "time_median_s": float(np.median(times)),
        "time_p95_s": float(np.percentile(times, 95)),
        "share_of_full_speed_percent": 100.0 * shortest / max(sum(times) * max_v, 1e-9),
        "path_over_way": sum(d.episode.path_length for d in reached) / max(shortest, 1e-9),
        "position_rmse_cm": 100.0 * float(np.sqrt(np.mean([d.episode.position_rmse**2 for d in drives]))),
        "heading_rmse_deg": math.degrees(float(np.sqrt(np.mean([d.episode.heading_rmse**2 for d in drives])))),
        "recoveries": sum(d.recoveries for d in drives),
        "control_us": 1e6 * float(np.median([np.median(d.episode.decision_times) for d in drives])),
        "failed_seeds": [d.seed for d in drives if not d.is_success],
    }


def _best(work: Callable[[], object], repeats: int = REPEATS) -> float:
    """Return the least wall-clock time of some work [us], after one run that compiles it."""
    return float(measure({"": work}, repeats, batch=1)[""].min())


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
    """Lay measures out, a column per world."""
    shown = Table("measure", *results)
    for name in next(iter(results.values())):
        shown.add_row(name, *(_text(result[name]) for result in results.values()))
    return shown


def _text(value: Any) -> str:
    if isinstance(value, float):
        return "never" if math.isnan(value) else f"{value:.3g}"
    return str(value)


def main(
    worlds: tuple[str, ...] = WORLDS,
    goals: Count = 200,
    jobs: Count = 2,
    seed: int = 0,
    physics: str = "bullet",
    localizer: str = "amcl",
    local_planner: str = MapNavigatorParams().local_planner,
    json: Path | None = None,
) -> None:
    """Measure the classic navigator on random goals.

    Args:
        worlds: Library worlds.
        goals: Goals in each; 0 measures the costs of planning alone.
        jobs: Processes to spread them over. Costs are cleanest with one per core or fewer.
        seed: Of the first goal; the next ones count up.
        physics: bullet or kinematic.
        localizer: amcl, odometry or truth.
        local_planner: rpp or dwb.
        json: Also write the measures to this file, as {world: {measure: value}}.
    """
    results = {}
    for world in worlds:
        tasks = [(world, physics, localizer, local_planner, seed + k) for k in range(goals)]
        max_v = _environment(world, physics, localizer).robot.max_v
        drives = run_each(_drive, tasks, jobs, desc=f"{world}, {local_planner}", unit="goal") if tasks else []
        results[world] = {**(summary(drives, max_v) if drives else {}), **planning_costs(world)}
    make_console().print(table(results))
    if json is not None:
        json.write_text(json_format.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    run_command(main)

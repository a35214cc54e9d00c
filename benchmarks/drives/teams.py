"""Benchmark of exploration by teams of robots: speed-up over team size."""

from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from lidarnaut.agents.statistics import estimate
from lidarnaut.benchmarks.arena.episodes import Episodes
from lidarnaut.benchmarks.arena.measures import Measures, texts
from lidarnaut.benchmarks.arena.publish import run_with_progress
from lidarnaut.benchmarks.arena.runner import Evaluation
from lidarnaut.benchmarks.arena.settings import Settings
from lidarnaut.benchmarks.drives.recording import Row
from lidarnaut.envs.command_line import Count, make_console
from lidarnaut.envs.measures import Measure
from lidarnaut.envs.slam import DEFAULT_SLAM
from lidarnaut.envs.tasks.explore import MAX_ROBOTS, Explore
from lidarnaut.envs.worlds import FAMILIES

MARK = 0.95
"""Explored fraction that ends an exploration episode, 0 to 1."""
MEASURES = Measures(Explore.measures, Explore.progress)
TIME = next(measure for measure in Explore.measures if measure.name == "time_to_95")
SPEED_UP = Measure("speed_up", "T(1) / T(n)", "", True, digits=2)
OVER = Measure("over", "time, relative", "", False, digits=2)


def compare_teams(
    worlds: tuple[str, ...] = ("rrt_house", "tugbot_warehouse", "rooms"),
    robots: tuple[int, ...] = tuple(range(1, MAX_ROBOTS + 1)),
    policies: tuple[str, ...] = ("rrt_team",),
    episodes: Count = 4,
    jobs: Count = 2,
    out: Path = Path("runs/team"),
) -> list[Row]:
    """Compare exploration times of teams by number of robots and by policy, in episodes with equal seeds.

    Args:
        worlds: library worlds and procedural families (20 m x 20 m, test split).
        robots: numbers of robots; speed-ups are relative to the first.
        policies: classic team policies; times are relative to the first.
        episodes: seeds per world.
        jobs: number of processes.
        out: output folder; an interrupted run resumes.
    """
    found: list[Row] = []
    library = tuple(world for world in worlds if world not in FAMILIES)
    families = tuple(world for world in worlds if world in FAMILIES)
    parts: Any = {"library": (library, {}), "families": (families, {"world_size": (20.0, 20.0)})}
    for num, policy, (part, (some, size)) in product(robots, policies, parts.items()):
        if some:
            settings = Settings(
                id="lidarnaut/ExploreTeam-v0",
                policies=(policy,),
                worlds=some,
                episodes=episodes,
                physics=("kinematic",),
                slam=(DEFAULT_SLAM,),
                arguments={"num_robots": num, "target_coverage": MARK, **size},
            )
            evaluation = Evaluation(settings, out / f"{policy}_{num}_{part}")
            run_with_progress(evaluation, jobs, make_console())
            found += [row | {"policy": f"{policy} {num}"} for row in evaluation.rows()]
    return summarise(found, robots, policies)


def summarise(rows: list[Row], robots: tuple[int, ...], policies: tuple[str, ...]) -> list[Row]:
    """Return table rows with exploration times and speed-ups, one for each world, policy and team size.

    `rows` are episode results, with the team size in the policy's name, such as "rrt_team 3". Ratios of two teams'
    times are interquartile means over equal seeds, or lower bounds if the first team missed 95 % explored.
    """
    together, lines = Episodes(rows, MEASURES), list[Row]()
    worlds = together.by_case()
    for world, here in (worlds | {"all": together} if len(worlds) > 1 else worlds).items():
        for policy, num in product(policies, robots):
            name = f"{policy} {num}"
            own, time = here.of(name), here.estimate(name, TIME)
            line = {"world": world, "policy": policy, "robots": num}
            line["time to 95 %, s"] = "{} [{}]".format(*texts(TIME, time))
            if robots[0] < num or robots[0] == 1:
                fewer = f"{policy} {robots[0]}"
                line[f"T({robots[0]}) / T(n)"] = _ratio(here, fewer, name, SPEED_UP)
            if len(policies) > 1:
                line[f"over {policies[0]}"] = _ratio(here, name, f"{policies[0]} {num}", OVER)
            line["reached"] = f"{time.n - time.never} of {time.n}"
            line["path of all, m"] = f"{np.median([row['path_length'] for row in own]):.0f}"
            lines.append(line | {"contacts": int(sum(row["collisions"] for row in own))})
    return lines


def _ratio(here: Episodes, a: str, b: str, measure: Measure) -> str:
    reached = [np.isfinite(times) for times in here.pairs(a, b, replace(TIME, limit=""))[0]]
    ratio = estimate([x / y for x, y in zip(*here.pairs(a, b, TIME), strict=True)], reached if a != b else None)
    return "{} [{}]".format(*texts(measure, ratio))

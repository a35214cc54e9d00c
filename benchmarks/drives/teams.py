"""How much faster several robots explore than one."""

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from benchmarks.arena.episodes import Episodes
from benchmarks.arena.measures import Measures, texts
from benchmarks.arena.publish import run_with_progress
from benchmarks.arena.runner import Evaluation
from benchmarks.arena.settings import Settings
from benchmarks.arena.statistics import estimate
from benchmarks.drives.recording import Row
from envs.command_line import Count, make_console
from envs.measures import Measure
from envs.slam import DEFAULT_SLAM
from envs.tasks.explore import MAX_ROBOTS, Explore
from envs.worlds import FAMILIES

MARK = 0.95
"""Explored fraction at which the time is taken, and the episode ends."""
MEASURES = Measures(Explore.measures, Explore.progress)
TIME = next(measure for measure in Explore.measures if measure.name == "time_to_95")
SPEED_UP = Measure("speed_up", "T(1) / T(n)", "", True, digits=2)


def compare_teams(
    worlds: tuple[str, ...] = ("rrt_house", "tugbot_warehouse", "rooms"),
    robots: tuple[int, ...] = tuple(range(1, MAX_ROBOTS + 1)),
    episodes: Count = 4,
    jobs: Count = 2,
    seed: int = 0,
    physics: Literal["kinematic", "bullet"] = "kinematic",
    slam: str = DEFAULT_SLAM,
    out: Path = Path("runs/team"),
) -> list[Row]:
    """How much faster several robots explore than one, by `rrt_team`, which starts them near each other with one map.

    The same seed is the same world and the same start for every number of robots, so times are compared pair by pair.

    Args:
        worlds: library worlds and procedural families (20 m x 20 m, test seeds).
        robots: numbers of robots.
        episodes: seeds in each world.
        jobs: processes.
        seed: of the first episode; the next ones count up.
        physics: simulator.
        slam: name of a SLAM whose map robots can share.
        out: folder of the evaluations; run again, the command goes on where it stopped.
    """
    found: list[Row] = []
    for num in robots:
        for part, more in (("library", {}), ("families", {"world_size": (20.0, 20.0)})):
            here = tuple(world for world in worlds if (world in FAMILIES) == bool(more))
            if not here:
                continue
            settings = Settings(
                id="lidarnaut/ExploreTeam-v0",
                policies=("rrt_team",),
                worlds=here,
                episodes=episodes,
                seed=seed,
                physics=(physics,),
                slam=(slam,),
                arguments={"num_robots": num, "target_coverage": MARK, **more},
            )
            evaluation = Evaluation(settings, out / f"{num}_{part}")
            run_with_progress(evaluation, jobs, make_console())
            found += [row | {"policy": str(num)} for row in evaluation.rows()]
    return summarise(found, robots)


def summarise(rows: list[Row], robots: tuple[int, ...]) -> list[Row]:
    """Return a line for each world and number of robots, of the rows of episodes whose policy is that number.

    T(1) / T(n) is an interquartile mean over pairs; where one robot never reached 95 %, the ratio is a lower bound.
    """
    together, lines = Episodes(rows, MEASURES), list[Row]()
    worlds = together.by_case()
    for world, here in (worlds | {"all": together} if len(worlds) > 1 else worlds).items():
        for num in map(str, robots):
            own, time = here.of(num), here.estimate(num, TIME)
            line = {"world": world, "robots": num, "time to 95 %, s": "{} [{}]".format(*texts(TIME, time))}
            if 1 in robots:
                pairs = zip(*here.pairs("1", num, TIME), strict=True)
                reached = [np.isfinite(times) for times in here.pairs("1", num, replace(TIME, limit=""))[0]]
                ratio = estimate([alone / many for alone, many in pairs], reached if num != "1" else None)
                line["T(1) / T(n)"] = "{} [{}]".format(*texts(SPEED_UP, ratio))
            line["reached"] = f"{time.n - time.never} of {time.n}"
            line["path of all, m"] = f"{np.median([row['path_length'] for row in own]):.0f}"
            lines.append(line | {"contacts": int(sum(row["collisions"] for row in own))})
    return lines

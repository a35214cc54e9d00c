"""How much faster several robots explore than one, and a picture of a team's map.

Robots of a team start near each other, share one map, and explore by `baselines.rrt.team`. The same seed is the same
world and the same start for every number of robots, so times are compared pair by pair. Run
`python -m benchmarks.team --help`.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from rich.table import Table

from baselines import RrtTeam
from baselines.episode import run_episode
from benchmarks.arena.measures import texts
from benchmarks.arena.pairs import paired_values, pool
from benchmarks.arena.plots import show_map, show_only
from benchmarks.arena.publish import run_with_progress
from benchmarks.arena.records import Row
from benchmarks.arena.runner import Evaluation
from benchmarks.arena.settings import Settings
from benchmarks.arena.statistics import Estimate, estimate
from benchmarks.arena.theme import LIGHT
from envs.command_line import Count, make_console, run_command
from envs.core import LidarEnv
from envs.estimation.map_pyramid import OCCUPIED_FROM
from envs.measures import Measure
from envs.slam import DEFAULT_SLAM
from envs.tasks.explore import MAX_ROBOTS, Explore, ExploreTeam
from envs.worlds import FAMILIES

WORLDS = ("rrt_house", "tugbot_warehouse", "rooms")
ROOMS_SIZE = (20.0, 20.0)
"""Outer size of the worlds of procedural families, whose test seeds are taken [m]."""
MARK = 0.95
"""Explored fraction at which the time is taken, and the episode ends."""
TIME = next(measure for measure in Explore.measures if measure.name == "time_to_95")
SPEED_UP = Measure("speed_up", "T(1) / T(n)", "", True, digits=2)
ID = "lidarnaut/ExploreTeam-v0"


def run(settings: Settings, num_robots: int, out: Path, jobs: int) -> list[Row]:
    """Evaluate teams of a size; return the rows of their episodes, whose policy is called by that size.

    Library worlds and families, which get a size, are evaluated into a folder each; what is there is not run again.
    """
    rows: list[Row] = []
    for part, more in (("library", {}), ("families", {"world_size": ROOMS_SIZE})):
        worlds = tuple(world for world in settings.worlds if (world in FAMILIES) == bool(more))
        if worlds:
            arguments = {"num_robots": num_robots, "target_coverage": MARK, **more}
            some = settings.model_copy(update={"worlds": worlds, "arguments": arguments})
            evaluation = Evaluation(some, out / f"{num_robots}_{part}")
            run_with_progress(evaluation, jobs, None, make_console())
            rows += [row | {"policy": str(num_robots)} for row in evaluation.rows()]
    return rows


def speed_up(rows: list[Row], num_robots: int) -> Estimate:
    """Return the interquartile mean of T(1) / T(n), pair by pair, with its interval.

    Where one robot alone never reached 95 %, the ratio is a lower bound.
    """
    alone, together = paired_values(rows, "1", str(num_robots), TIME)
    unlimited = paired_values(rows, "1", str(num_robots), replace(TIME, limit=""))[0]
    ratios = [one / many for one, many in zip(alone, together, strict=True)]
    return estimate(ratios, [np.isfinite(times) for times in unlimited] if num_robots > 1 else None)


def table(rows: list[Row], robots: tuple[int, ...]) -> Table:
    """Show worlds and numbers of robots side by side."""
    shown = Table("world", "robots", "time to 95 %, s", "T(1) / T(n)", "reached", "path of all, m", "contacts")
    worlds = {
        world: [row for row in rows if row["world"] == world] for world in dict.fromkeys(r["world"] for r in rows)
    }
    for world, here in (worlds | {"all": rows} if len(worlds) > 1 else worlds).items():
        for num in robots:
            own = [row for row in here if row["policy"] == str(num)]
            time = pool(own, str(num), TIME)
            shown.add_row(
                world,
                str(num),
                "{} [{}]".format(*texts(TIME, time)),
                "{} [{}]".format(*texts(SPEED_UP, speed_up(here, num))) if 1 in robots else "",
                f"{time.n - time.never} of {time.n}",
                f"{np.median([row['path_length'] for row in own]):.0f}",
                f"{sum(row['collisions'] for row in own):.0f}",
            )
    return shown


def draw(env: LidarEnv, time: float) -> Figure:
    """Draw the shared map over the true walls at a time [s], and the trail of each robot in its own colour."""
    grid, theme, start = env.robots[0].belief.grid, LIGHT, env.map_pose
    x_min, y_min, x_max, y_max = env.world.bounds
    width, height = x_max - x_min, y_max - y_min
    figure = Figure(figsize=(7.0, 7.0 * height / width + 0.5), dpi=110, layout="constrained", facecolor=theme.paper)
    axes = figure.subplots()
    picture = np.full((*grid.data.shape, 4), to_rgba(theme.unknown), dtype=np.float32)
    picture[(grid.data >= 0) & (grid.data < OCCUPIED_FROM)] = to_rgba(theme.paper)
    picture[grid.data >= OCCUPIED_FROM] = to_rgba(theme.ink)
    show_map(axes, picture, grid, start, env.world.segments, theme)
    for k, (robot, truth) in enumerate(zip(env.robots, env.truths)):
        color = theme.lines[k]
        trail = start.transform(robot.trail.positions)
        label = f"robot {k}, {truth.path_length:.0f} m"
        axes.plot(*trail.T, color=color, linewidth=1.6, label=label)
        axes.plot(*trail[0], marker="o", markersize=5, color=theme.paper, markeredgecolor=color, markeredgewidth=1.5)
        axes.plot(*trail[-1], marker="o", markersize=7, color=color, markeredgecolor=theme.paper)
    show_only(axes, (x_min - 0.3, x_max + 0.3, y_min - 0.3, y_max + 0.3), theme.unknown)
    fraction = 100.0 * env.task.coverage.explored_fraction
    axes.set_title(f"{env.world.name}: {fraction:.0f} % after {time:.0f} s", color=theme.ink, fontsize=10)
    figure.legend(loc="outside lower center", ncols=len(env.robots), frameon=False, labelcolor=theme.ink, fontsize=9)
    return figure


def main(
    worlds: tuple[str, ...] = WORLDS,
    robots: tuple[int, ...] = tuple(range(1, MAX_ROBOTS + 1)),
    episodes: Count = 4,
    jobs: Count = 2,
    seed: int = 0,
    physics: str = "kinematic",
    slam: str = DEFAULT_SLAM,
    out: Path = Path("runs/team"),
    picture: str | None = None,
) -> None:
    """Measure how much faster several robots explore than one.

    Args:
        worlds: Library worlds and procedural families (20 m x 20 m, test seeds).
        robots: Numbers of robots.
        episodes: Seeds in each world.
        jobs: Processes.
        seed: Of the first episode; the next ones count up.
        physics: kinematic or bullet.
        slam: name of a SLAM whose map robots can share.
        out: Folder of the evaluations; run again, the command goes on where it stopped.
        picture: Instead, draw the map of this world with the most robots into out/team.png.
    """
    if picture is not None:
        size = ROOMS_SIZE if picture in FAMILIES else None
        team = {"num_robots": max(robots), "target_coverage": MARK, "split": "test"}
        env = LidarEnv(ExploreTeam, world=picture, world_size=size, physics=physics, slam=slam, **team)
        run_episode(env, RrtTeam(), seed)
        out.mkdir(parents=True, exist_ok=True)
        draw(env, env.time).savefig(out / "team.png")
        env.close()
        return
    settings = Settings(
        id=ID, policies=("rrt_team",), worlds=worlds, episodes=episodes, seed=seed, physics=(physics,), slam=(slam,)
    )
    rows = [row for num in robots for row in run(settings, num, out, jobs)]
    make_console().print(table(rows, robots))


if __name__ == "__main__":
    run_command(main)

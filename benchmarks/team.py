"""How much faster several robots explore than one, and a picture of a team's map.

Robots of a team start near each other, share one map, and explore by `baselines.rrt.team`. The same seed is the same
world and the same start for every number of robots, so times are compared pair by pair. Run
`python -m benchmarks.team --help`.
"""

from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from rich.table import Table

from baselines import RrtTeam
from baselines.episode import run_episode
from benchmarks.arena.measures import texts
from benchmarks.arena.plots import show_map, show_only
from benchmarks.arena.records import Row, append_row, read_tables
from benchmarks.arena.statistics import Estimate, estimate
from benchmarks.arena.theme import LIGHT
from benchmarks.parallel import run_each
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

TASK = ("world", "num_robots", "seed", "physics", "slam")
COLUMNS = (
    *TASK,
    *("time_to_95", "time_to_90", "explored_fraction", "area_left"),
    *("path_length", "longest_path", "collisions", "position_rmse", "end_reason", "time_limit"),
)
READERS = dict.fromkeys(COLUMNS, str) | {"num_robots": int, "seed": int}
"""Columns of the CSV file, and how they are read."""


def make_env(world: str, num_robots: int, physics: str, slam: str) -> LidarEnv:
    """Make the environment of an episode."""
    return LidarEnv(
        ExploreTeam,
        world=world,
        num_robots=num_robots,
        physics=physics,
        slam=slam,
        split="test",
        world_size=ROOMS_SIZE if world in FAMILIES else None,
        target_coverage=MARK,
    )


def measure(world: str, num_robots: int, seed: int, physics: str, slam: str) -> Row:
    """Run an episode."""
    env = make_env(world, num_robots, physics, slam)
    episode = run_episode(env, RrtTeam(), seed)
    env.close()
    own = dict(zip(TASK, (world, num_robots, seed, physics, slam)))
    own |= {"longest_path": float(episode.course.final["path_length"].max()), "collisions": int(episode.collisions)}
    return {name: own[name] if name in own else getattr(episode, name) for name in COLUMNS}


def run(tasks: list[tuple[str, int, int, str, str]], jobs: int, path: Path) -> list[Row]:
    """Run episodes in processes and append them to a CSV file as they end; those that are in it are not run again.

    Raises:
        ValueError: the file has other columns.
    """
    rows = {tuple(row[name] for name in TASK): row for row in read_tables(path.parent, path.stem, READERS)}
    missing = [task for task in tasks if task not in rows]
    results = run_each(measure, missing, jobs, partial(append_row, path, READERS), unit="episode") if missing else []
    rows |= zip(missing, results)
    return [rows[task] for task in tasks]


def values(rows: list[Row], name: str, world: str, num_robots: int) -> np.ndarray:
    """Return a measure of the episodes of a world with so many robots, in the order of their seeds."""
    chosen = [row for row in rows if (row["world"], row["num_robots"]) == (world, num_robots)]
    return np.array([float(row[name]) for row in sorted(chosen, key=lambda row: row["seed"])])


def times(rows: list[Row], world: str, num_robots: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the times to 95 % [s], the time limit where it was never reached, and whether it was reached."""
    reached = values(rows, "explored_fraction", world, num_robots) >= MARK
    limits = values(rows, "time_limit", world, num_robots)
    return np.where(reached, values(rows, "time_to_95", world, num_robots), limits), reached


def speed_up(rows: list[Row], worlds: tuple[str, ...], num_robots: int) -> Estimate:
    """Return the interquartile mean of T(1) / T(n), pair by pair, with its interval.

    Where one robot alone never reached 95 %, the ratio is a lower bound.
    """
    alone = [times(rows, world, 1) for world in worlds]
    ratios = [time / times(rows, world, num_robots)[0] for world, (time, _) in zip(worlds, alone)]
    return estimate(ratios, [reached for _, reached in alone] if num_robots > 1 else None)


def table(rows: list[Row], worlds: tuple[str, ...], robots: tuple[int, ...]) -> Table:
    """Show worlds and numbers of robots side by side."""
    shown = Table("world", "robots", "time to 95 %, s", "T(1) / T(n)", "reached", "path of all, m", "contacts")
    for pooled in [*((world,) for world in worlds), *([worlds] if len(worlds) > 1 else [])]:
        for num in robots:
            taken, reached = zip(*(times(rows, world, num) for world in pooled))
            paths, contacts = (
                np.concatenate([values(rows, name, world, num) for world in pooled])
                for name in ("path_length", "collisions")
            )
            shown.add_row(
                pooled[0] if len(pooled) == 1 else "all",
                str(num),
                "{} [{}]".format(*texts(TIME, estimate(taken, reached))),
                "{} [{}]".format(*texts(SPEED_UP, speed_up(rows, pooled, num))) if 1 in robots else "",
                f"{np.concatenate(reached).sum()} of {len(paths)}",
                f"{np.median(paths):.0f}",
                f"{contacts.sum():.0f}",
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
        out: Folder for episodes.csv; run again, the command goes on where it stopped.
        picture: Instead, draw the map of this world with the most robots into out/team.png.
    """
    out.mkdir(parents=True, exist_ok=True)
    if picture is not None:
        env = make_env(picture, max(robots), physics, slam)
        run_episode(env, RrtTeam(), seed)
        draw(env, env.time).savefig(out / "team.png")
        env.close()
        return
    tasks = [(world, num, seed + k, physics, slam) for k in range(episodes) for world in worlds for num in robots]
    rows = run(tasks, jobs, out / "episodes.csv")
    make_console().print(table(rows, worlds, robots))


if __name__ == "__main__":
    run_command(main)

"""How much faster several robots explore than one, and a picture of a team's map.

Robots of a team start near each other, share one map, and explore by `baselines.rrt.team`. The same seed is the same
world and the same start for every number of robots, so times are compared pair by pair. Run
`python -m benchmarks.team --help`.
"""

import csv
import multiprocessing
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

import numpy as np
import tyro
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.transforms import Affine2D
from rich.console import Console
from rich.table import Table
from tqdm import tqdm

from baselines.rrt.team import RrtTeam
from baselines.rrt.team_episode import run_team_episode
from benchmarks.arena.measures import Measure
from benchmarks.arena.statistics import Estimate, estimate
from benchmarks.arena.theme import LIGHT
from envs.estimation.map_pyramid import OCCUPIED_FROM
from envs.explore_team import MAX_ROBOTS, ExploreTeamEnv

WORLDS = ("rrt_house", "tugbot_warehouse", "rooms")
ROOMS_SIZE = (20.0, 20.0)
"""Outer size of the worlds of procedural families, whose test seeds are taken [m]."""
MARK = 0.95
"""Explored fraction at which the time is taken, and the episode ends."""
TIME = Measure("time_to_95", "time to 95 %", "s", False, 0)
SPEED_UP = Measure("speed_up", "T(1) / T(n)", "", True, 2)

Task = tuple[str, int, int, str, str]
"""World, number of robots, seed, physics, SLAM."""
Row = dict[str, str | int | float]
COLUMNS = (
    *("world", "num_robots", "seed", "physics", "slam"),
    *("time_to_95", "time_to_90", "explored_fraction", "area_left"),
    *("path_length", "longest_path", "collisions", "position_rmse", "end_reason", "time_limit"),
)
"""Of the CSV file; the first five are those of the task."""


def make_env(world: str, num_robots: int, physics: str, slam: str, target_coverage: float = MARK) -> ExploreTeamEnv:
    """Make the environment of an episode."""
    is_family = world in ("rooms", "maze", "warehouse", "caves")
    return ExploreTeamEnv(
        world=world,
        num_robots=num_robots,
        physics=physics,
        slam=slam,
        split="test",
        world_size=ROOMS_SIZE if is_family else None,
        target_coverage=target_coverage,
    )


def measure(task: Task) -> Row:
    """Run an episode."""
    world, num_robots, seed, physics, slam = task
    env = make_env(world, num_robots, physics, slam)
    episode = run_team_episode(env, RrtTeam(), seed)
    env.close()
    return {
        "world": world,
        "num_robots": num_robots,
        "seed": seed,
        "physics": physics,
        "slam": slam,
        "time_to_95": episode.time_to_95,
        "time_to_90": episode.time_to_90,
        "explored_fraction": episode.explored_fraction,
        "area_left": episode.area_left,
        "path_length": float(episode.path_length.sum()),
        "longest_path": float(episode.path_length.max()),
        "collisions": int(episode.collisions.sum()),
        "position_rmse": float(np.sqrt((episode.position_rmse**2).mean())),
        "end_reason": episode.end_reason,
        "time_limit": episode.time_limit,
    }


def run(tasks: list[Task], jobs: int, path: Path) -> list[Row]:
    """Run episodes in processes and append them to a CSV file as they end; those that are in it are not run again.

    Raises:
        ValueError: the file has other columns.
    """
    rows: list[Row] = []
    if path.exists():
        with path.open(newline="") as file:
            reader = csv.DictReader(file)
            if tuple(reader.fieldnames or ()) != COLUMNS:
                raise ValueError(f"{path} has other columns than this version writes; choose another --out")
            rows += [{**row, **{key: int(row[key]) for key in ("num_robots", "seed")}} for row in reader]
    done = {_task(row) for row in rows}
    missing = [task for task in tasks if task not in done]
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        futures = [pool.submit(measure, task) for task in missing]
        for future in tqdm(as_completed(futures), total=len(missing), unit="episode"):
            rows.append(future.result())
            is_new = not path.exists()
            with path.open("a", newline="") as file:
                writer = csv.DictWriter(file, COLUMNS)
                if is_new:
                    writer.writeheader()
                writer.writerow(rows[-1])
    return [row for row in rows if _task(row) in tasks]


def _task(row: Row) -> tuple[str | int | float, ...]:
    return tuple(row[key] for key in COLUMNS[:5])


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
                _text(estimate(taken, reached), TIME),
                _text(speed_up(rows, pooled, num), SPEED_UP) if 1 in robots else "",
                f"{np.concatenate(reached).sum()} of {len(paths)}",
                f"{np.median(paths):.0f}",
                f"{contacts.sum():.0f}",
            )
    return shown


def _text(numbers: Estimate, measure: Measure) -> str:
    return "{} [{}]".format(*measure.texts(numbers))


def draw(env: ExploreTeamEnv, time: float) -> Figure:
    """Draw the shared map over the true walls, and the trail of each robot in its own colour.

    Args:
        env: at the end of an episode.
        time: since the reset [s].
    """
    grid, theme, start = env.beliefs[0].grid, LIGHT, env.start
    x_min, y_min, x_max, y_max = env.world.bounds
    width, height = x_max - x_min, y_max - y_min
    figure = Figure(figsize=(7.0, 7.0 * height / width + 0.5), dpi=110, layout="constrained", facecolor=theme.paper)
    axes = figure.subplots()
    picture = np.full((*grid.data.shape, 4), to_rgba(theme.unknown), dtype=np.float32)
    picture[(grid.data >= 0) & (grid.data < OCCUPIED_FROM)] = to_rgba(theme.paper)
    picture[grid.data >= OCCUPIED_FROM] = to_rgba(theme.ink)
    left, low, right, high = grid.bounds
    image = axes.imshow(picture, origin="lower", extent=(left, right, low, high), interpolation="auto")
    image.set_transform(Affine2D().rotate(start.theta).translate(start.x, start.y) + axes.transData)
    walls = LineCollection(list(env.world.segments.reshape(-1, 2, 2)), colors=theme.error, linewidths=0.6, alpha=0.7)
    axes.add_collection(walls)
    for k, (robot, truth) in enumerate(zip(env.robots, env.truths)):
        color = theme.lines[k]
        trail = start.transform(robot.trail.positions)
        label = f"robot {k}, {truth.path_length:.0f} m"
        axes.plot(*trail.T, color=color, linewidth=1.6, label=label)
        axes.plot(*trail[0], marker="o", markersize=5, color=theme.paper, markeredgecolor=color, markeredgewidth=1.5)
        axes.plot(*trail[-1], marker="o", markersize=7, color=color, markeredgecolor=theme.paper)
    axes.set(xlim=(x_min - 0.3, x_max + 0.3), ylim=(y_min - 0.3, y_max + 0.3), xticks=[], yticks=[], aspect="equal")
    axes.set_facecolor(theme.unknown)
    fraction = 100.0 * env.coverage.explored_fraction
    axes.set_title(f"{env.world.name}: {fraction:.0f} % after {time:.0f} s", color=theme.ink, fontsize=10)
    figure.legend(loc="outside lower center", ncols=len(env.robots), frameon=False, labelcolor=theme.ink, fontsize=9)
    for spine in axes.spines.values():
        spine.set_visible(False)
    return figure


def main(
    worlds: tuple[str, ...] = WORLDS,
    robots: tuple[int, ...] = tuple(range(1, MAX_ROBOTS + 1)),
    episodes: int = 4,
    jobs: int = 2,
    seed: int = 0,
    physics: str = "kinematic",
    slam: str = "tinyslam",
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
        slam: tinyslam, odometry or truth.
        out: Folder for episodes.csv; run again, the command goes on where it stopped.
        picture: Instead, draw the map of this world with the most robots into out/team.png.
    """
    out.mkdir(parents=True, exist_ok=True)
    if picture is not None:
        env = make_env(picture, max(robots), physics, slam)
        run_team_episode(env, RrtTeam(), seed)
        draw(env, env.time).savefig(out / "team.png")
        env.close()
        return
    tasks = [(world, num, seed + k, physics, slam) for k in range(episodes) for world in worlds for num in robots]
    rows = run(tasks, jobs, out / "episodes.csv")
    Console().print(table(rows, worlds, robots))


if __name__ == "__main__":
    tyro.cli(main)

"""Simulated drives in known worlds, recorded once and replayed through SLAM or localization."""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import astuple, dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from rich.table import Table

from lidarnaut.agents.pools import make_pool
from lidarnaut.envs.estimation import Estimator
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.navigation import CostmapParams, make_costmap, plan_path
from lidarnaut.envs.progress import Progress
from lidarnaut.envs.robots import RobotParams
from lidarnaut.envs.simulation import Reading, Twist, make_simulator
from lidarnaut.envs.worlds import ExplorableArea, World, explorable_area

RESOLUTION = 0.05
"""Map resolution [m]."""
PERIOD = 0.1
"""Control and scan period [s]."""
Row = dict[str, Any]
"""Row of a result table by column name; None for an event that never happened."""


class Setup(NamedTuple):
    """World, robot and simulator of a recorded drive."""

    world: World
    robot: RobotParams
    area: ExplorableArea
    """Cells of the world that the robot can reach or observe."""
    physics: str


def make_setup(world: World, robot: RobotParams, physics: str) -> Setup:
    return Setup(world, robot, explorable_area(world, robot, RESOLUTION), physics)


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """Recorded drive: n scans, odometry and true poses."""

    ranges: np.ndarray
    """Lidar ranges, shape (n, num_beams), float32 [m]."""
    motions: np.ndarray
    """Odometry motion (x, y, heading) since the previous scan, in the robot frame at that scan: shape (n, 3), float64
    [m, m, rad]."""
    truth: np.ndarray
    """True poses (x, y, heading) in the world frame, or reference poses of a log: shape (n, 3), float64 [m, m, rad]."""
    bumper: np.ndarray
    """Contacts since the previous scan, shape (n,), bool."""

    def at_true_poses(self) -> "Drive":
        """Return the drive with true motions instead of odometry."""
        poses = [Pose2D(*pose) for pose in self.truth.tolist()]
        return replace(self, motions=np.array([before.between(pose) for before, pose in zip(poses[:1] + poses, poses)]))

    def then(self, other: "Drive", scans: int) -> "Drive":
        """Return a drive with a kidnapped robot: the first `scans` scans, then `other`, without odometry in between."""
        return Drive(*(np.concatenate([own[:scans], others]) for own, others in zip(astuple(self), astuple(other))))


def record(
    setup: Setup,
    start: Pose2D,
    rng_simulator: np.random.Generator,
    rng_driver: np.random.Generator,
    duration: float,
    driver: Callable[..., Iterator[Twist]] | None = None,
) -> Drive:
    """Record a drive from `start` for `duration` [s]; `driver`: source of commands, default `random_goals`."""
    robot = setup.robot
    simulator = make_simulator(setup.physics, robot, PERIOD)
    reading = simulator.reset(setup.world, [start], [rng_simulator])[0]
    rows = [(reading.ranges, reading.motion, simulator.states[0].pose, reading.bumper)]
    twists = (driver or random_goals)(setup, simulator, rng_driver)
    for _ in range(round(duration / PERIOD)):
        reading = simulator.step([next(twists)])[0]
        rows.append((reading.ranges, reading.motion, simulator.states[0].pose, reading.bumper))
    simulator.close()
    return Drive(*map(np.array, zip(*rows)))


def random_goals(setup: Setup, simulator: Any, rng: np.random.Generator) -> Iterator[Twist]:
    """Yield commands that drive the robot to random goals, by its true pose."""
    robot = setup.robot
    params = CostmapParams(robot_radius=robot.radius + 0.02, inflation_radius=robot.radius + 0.5)
    costmap, path = make_costmap(setup.area.walls, params), np.empty((0, 2))
    while True:
        pose = simulator.states[0].pose
        path = _ahead(path, pose)
        while len(path) == 0:
            found = plan_path(costmap, pose[:2], setup.area.draw_pose(rng)[:2], tolerance=0.3)
            path = path if found is None else _ahead(found, pose)
        x, y = pose.inverse().transform(path[:1])[0]
        angle, top_w = math.atan2(y, x), min(robot.max_w, 1.0)
        if abs(angle) > 0.6:
            yield Twist(0.0, math.copysign(top_w, angle))
        else:
            yield Twist(robot.max_v * math.cos(angle) ** 2, float(np.clip(2.0 * angle, -top_w, top_w)))


def _ahead(path: np.ndarray, pose: Pose2D) -> np.ndarray:
    near = np.flatnonzero(np.hypot(*(path - pose[:2]).T) < 0.3)
    return path[near[-1] + 1 :] if len(near) else path


def record_drive(setup: Setup, seed: int, duration: float) -> Drive:
    rng_simulator, _, rng_driver = np.random.default_rng(seed).spawn(3)
    return record(setup, setup.world.spawns[0], rng_simulator, rng_driver, duration)


def track(estimator: Estimator, drive: Drive, *noted: str) -> dict[str, np.ndarray]:
    """Run a SLAM or localizer along a recorded drive of n scans.

    Returns estimated `poses`, shape (n, 3) [m, m, rad], `is_lost`, shape (n,), bool, update times `seconds`, shape (n,)
    [s], and values of the estimator's attributes named in `noted`.
    """
    rows = []
    for ranges, motion, bumper in zip(drive.ranges, drive.motions.tolist(), drive.bumper.tolist()):
        began = time.perf_counter()
        belief = estimator.update(Reading.of_scan(ranges)._replace(bumper=bumper), Pose2D(*motion))
        seconds = time.perf_counter() - began
        rows.append((belief.pose, belief.is_lost, seconds, *(getattr(estimator, name) for name in noted)))
    return dict(zip(("poses", "is_lost", "seconds", *noted), map(np.array, zip(*rows))))


def right_since(is_right: np.ndarray, hold: float) -> float:
    """Return the time after which a pose estimate stays correct until the end of the drive [s].

    `is_right` has one flag per scan. Returns inf if a flag of the last `hold` [s] is False.
    """
    if not is_right[-round(hold / PERIOD) :].all():
        return math.inf
    wrong = np.flatnonzero(~is_right)
    return float(wrong[-1] + 1) * PERIOD if len(wrong) else 0.0


def first_time(flags: np.ndarray) -> float:
    """Return the time of the first scan whose flag is True [s]; inf if there is none."""
    return float(np.argmax(flags)) * PERIOD if flags.any() else math.inf


def run_each(work: Callable[..., Any], tasks: Sequence[tuple[Any, ...]], jobs: int, desc: str) -> list[Any]:
    if jobs == 1:
        return [work(*task) for task in Progress(tasks, desc)]
    with make_pool(jobs) as pool:
        return list(Progress(pool.map(work, *zip(*tasks)), desc, len(tasks)))


def medians(rows: Sequence[Row]) -> Row:
    return {key: float(np.median([row[key] for row in rows])) for key in rows[0]}


def table(rows: Sequence[Row], title: str | None = None) -> Table:
    """Return a terminal table of results, transposed if there are more than nine columns."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    lines = [names, *([_cell(row.get(name, "")) for name in names] for row in rows)]
    if len(names) > 9:
        lines = [list(line) for line in zip(*lines)]
    made = Table(*lines[0], title=title)
    for line in lines[1:]:
        made.add_row(*line)
    return made


def _cell(value: Any) -> str:
    return "never" if value is None else f"{value:,.4g}" if isinstance(value, float) else str(value)

"""AMCL on the maps of known worlds, on the log of a real robot, and what its updates cost."""

import itertools
import math
import os
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from scipy import ndimage

from benchmarks.drives.recording import (
    LOG,
    PERIOD,
    RESOLUTION,
    Drive,
    Row,
    Setup,
    first_time,
    make_setup,
    medians,
    record,
    right_since,
    run_each,
    track,
)
from envs.arguments import choose_robot
from envs.command_line import Count
from envs.geometry import FREE, OCCUPIED, OccupancyGrid, Pose2D
from envs.localization import PRESETS, Amcl, AmclParams, load_preset
from envs.localization.likelihood_field import LikelihoodField
from envs.localization.motion_model import move_particles
from envs.localization.resampling import resample
from envs.logs import Log, load_log, pose_errors, rms
from envs.robots import LidarParams
from envs.simulation import Reading
from envs.slam import KnownPoses, TinySlamParams
from envs.tasks.goals import known_map
from envs.worlds import load_world

WORLDS = ("turtlebot3_world", "turtlebot3_house", "tugbot_warehouse")
TRACKING_TIME, KIDNAPPED_AT, RECOVERY_TIME = 60.0, 20.0, 90.0
"""How long robots are tracked and localized globally, when one is kidnapped, and how long it drives after that [s]."""
NEAR, NEAR_ANGLE = 0.5, math.radians(20.0)
"""Greatest errors of a correct estimate [m, rad]."""
HOLD = 5.0
"""A robot is localized if its estimate is correct for this long at the end [s]."""
START_STD = (0.05, 0.05, 0.05)
"""Standard deviations of the initial pose in known worlds [m, m, rad]."""
LOG_START_STD = (0.1, 0.1, 0.05)
"""The same on the log."""
LOG_SEEDS = range(100, 105)
SHARE_OF_HITS = 16
"""A cell of the log's map is occupied from this share of hits among all that beams say of it [percent]: what log odds
make of 0.9 for a hit and 0.4 for a pass, as Hector has them."""
HIT_COUNTS = TinySlamParams(
    resolution=0.05,
    map_width=60.0,
    map_height=60.0,
    hole_width=0.0,
    occupied_prob=1.0,
    empty_prob=0.0,
    quality=1.0,
    raw_quality=1.0,
    skip_exceeding=True,
)
"""Cells that count hits and passes."""
NAV2_PROB = replace(PRESETS["nav2"], sensor="likelihood_field_prob")
ALONE = replace(PRESETS["default"], relocalize=False)
FILTERS = {
    "nav2 likelihood_field": PRESETS["nav2"],
    "nav2 likelihood_field_prob": NAV2_PROB,
    "nav2 likelihood_field_prob, 2000 particles": replace(NAV2_PROB, min_particles=2000),
    "nav2 beam": replace(PRESETS["nav2"], sensor="beam", max_range=30.0),
    "default": ALONE,
    "default, 2000 particles, all beams": replace(ALONE, min_particles=2000, max_beams=180, squash=9.0),
}
"""Filters that are compared on the log, without relocalization, so that no error is hidden."""
REPEATS = 5
"""Measurements of a time; the median of their medians is reported."""
PARTICLE_TIMES = (0.0, 0.2, 3.0, 15.0)
"""Times at which particles are drawn [s]."""


class Track(NamedTuple):
    """Estimates at the n scans of a drive, all of shape (n, ...); see `track`."""

    poses: np.ndarray
    is_lost: np.ndarray
    seconds: np.ndarray
    fit: np.ndarray
    is_corrected: np.ndarray
    num_particles: np.ndarray


def localize(
    amcl: Amcl, grid: OccupancyGrid, drive: Drive, seed: int, start_std: tuple[float, float, float] | None
) -> Track:
    """Reset a filter with a seed, and localize along a drive on a map.

    `start_std` are the standard deviations of the initial pose, which is the true one [m, m, rad]; None for global
    localization.
    """
    start = None if start_std is None else Pose2D(*drive.truth[0].tolist())
    covariance = None if start_std is None else np.diag(np.square(start_std))
    amcl.reset(np.random.default_rng(seed), start, grid, covariance)
    return Track(*track(amcl, drive, "fit", "is_corrected", "num_particles"))


@lru_cache(maxsize=4)
def load_known_world(name: str, physics: str = "kinematic") -> Setup:
    """Load a library world, in which robots are localized on `known_map` of its area.

    Walls of library worlds tend to lie on the border between cells, which would move all of them half a cell up and
    right: the raster is shifted so that the outer walls run through the middle of cells.
    """
    world, half = load_world(name), 0.5 * RESOLUTION
    bounds = np.array(world.bounds) + (-half, -half, half, half)
    return make_setup(replace(world, bounds=tuple(bounds.tolist())), choose_robot(None, name), physics)


def record_from_anywhere(setup: Setup, seed: np.random.SeedSequence, duration: float) -> Drive:
    """Drive a robot to random goals from a random start for `duration` [s]."""
    rng_simulator, rng_driver = map(np.random.default_rng, seed.spawn(2))
    return record(setup, setup.area.draw_pose(rng_driver), rng_simulator, rng_driver, duration)


def symmetries(grid: OccupancyGrid, share: float = 0.9) -> list[Pose2D]:
    """Find the turns by multiples of 30 degrees about the middle of the free space that lay a map over itself.

    At least a `share` of its occupied cells must come to lie within two cells of another one. Returns the motions, in
    the map frame.
    """
    occupied = grid.data == OCCUPIED
    distances = ndimage.distance_transform_edt(~occupied)
    points = grid.centers(np.argwhere(occupied))
    middle = grid.centers(np.argwhere(grid.data == FREE)).mean(axis=0)
    found = []
    for k in range(1, 12):
        turn = Pose2D(0.0, 0.0, math.radians(30.0 * k))
        motion = Pose2D(*(middle - turn.transform(middle[None])[0]).tolist(), turn.theta)
        cells = grid.cells(motion.transform(points))
        near = distances[tuple(cells[grid.contains(cells)].T)] <= 2.0
        if np.count_nonzero(near) >= share * len(points):
            found.append(motion)
    return found


def compare_amcl(
    runs: Count = 100,
    jobs: Count = 2,
    worlds: tuple[str, ...] = WORLDS,
    physics: Literal["kinematic", "bullet"] = "kinematic",
    preset: str = "default",
    first_seed: int = 0,
) -> list[Row]:
    """Accuracy of AMCL in known worlds, where robots drive to random goals from random starts.

    With every seed one is tracked from a known pose, one is localized globally, and one is kidnapped;
    docs/localization.md says how each is judged.

    Args:
        runs: seeds per world.
        jobs: number of processes.
        worlds: library worlds.
        physics: simulator.
        preset: of AMCL.
        first_seed: seed of the first run.
    """
    rows = []
    for world in worlds:
        tasks = [(world, preset, physics, seed) for seed in range(first_seed, first_seed + runs)]
        found = run_each(run, tasks, jobs, world)
        done = {key: np.array([one[key] for one in found]) for key in found[0]}
        row = {
            "world": world,
            "tracking_rmse_m": rms(done["position"]),
            "tracking_rmse_deg": rms(done["heading"]),
            "tracking_worst_run_m": float(done["position"].max()),
            "tracking_worst_run_deg": float(done["heading"].max()),
            "symmetries": len(symmetries(known_map(load_known_world(world, physics).area))),
            "global_success": float(done["found"].mean()),
            "global_success_up_to_symmetry": float(done["found_up_to_symmetry"].mean()),
            "global_median_s": time_quantile(done["found_after"], 0.5),
            "global_p90_s": time_quantile(done["found_after"], 0.9),
            "kidnapped_recovery": float(np.isfinite(done["recovered_after"]).mean()),
            "kidnapped_median_s": time_quantile(done["recovered_after"], 0.5),
            "kidnapped_p90_s": time_quantile(done["recovered_after"], 0.9),
            "kidnapped_noticed_median_s": time_quantile(done["noticed_after"], 0.5),
            "confident_and_wrong_share": float(done["confident_and_wrong"].mean()),
            "lost_while_right_share": float(done["lost_while_right"].mean()),
        }
        rows.append(row)
    return rows


def time_quantile(times: Sequence[float], share: float) -> float | None:
    """Return a quantile of times of which some, never reached, are inf; None if that quantile was never reached."""
    if math.isinf(np.quantile(times, share, method="higher")):
        return None
    return float(np.quantile(np.nan_to_num(times), share))


def run(world: str, preset: str, physics: str, seed: int) -> Row:
    """Do all three experiments with one seed."""
    setup = load_known_world(world, physics)
    grid, amcl = known_map(setup.area), Amcl(setup.robot.lidar, load_preset(preset))
    first, second = np.random.SeedSequence(seed).spawn(2)
    drive = record_from_anywhere(setup, first, TRACKING_TIME)
    elsewhere = record_from_anywhere(setup, second, RECOVERY_TIME)

    tracked = localize(amcl, grid, drive, seed, START_STD)
    distance, angle = pose_errors(tracked.poses, drive.truth)

    found = localize(amcl, grid, drive, seed, None)
    is_right = _is_right(found.poses, drive.truth)
    turned = [[motion.compose(Pose2D(*pose)) for pose in drive.truth.tolist()] for motion in symmetries(grid)]
    is_right_turned = [is_right, *(_is_right(found.poses, np.array(truth)) for truth in turned)]

    scans = round(KIDNAPPED_AT / PERIOD)
    kidnapped = drive.then(elsewhere, scans)
    recovered = localize(amcl, grid, kidnapped, seed, START_STD)
    is_right_again = _is_right(recovered.poses, kidnapped.truth)[scans:]
    is_lost_again = recovered.is_lost[scans:]
    wrong = np.concatenate([~is_right & ~found.is_lost, ~is_right_again & ~is_lost_again])
    return {
        "position": rms(distance),
        "heading": math.degrees(rms(angle)),
        "lost_while_right": float(np.mean(tracked.is_lost & _is_right(tracked.poses, drive.truth))),
        "found": math.isfinite(right_since(is_right, HOLD)),
        "found_up_to_symmetry": any(math.isfinite(right_since(one, HOLD)) for one in is_right_turned),
        "found_after": right_since(is_right, HOLD),
        "recovered_after": right_since(is_right_again, HOLD),
        "noticed_after": first_time(is_lost_again),
        "confident_and_wrong": float(np.mean(wrong)),  # share of the time of these two experiments
    }


def _is_right(poses: np.ndarray, truth: np.ndarray) -> np.ndarray:
    distance, angle = pose_errors(poses, truth)
    return (distance <= NEAR) & (angle <= NEAR_ANGLE)


def compare_on_log(log: Path = LOG) -> list[Row]:
    """AMCL on the log of a real robot, on a map made from its reference poses; medians over seeds.

    Args:
        log: whose arrays also hold the reference, `corr`.
    """
    read, drive = load_reference(log)
    grid = reference_map(read, drive.truth)
    rows = []
    for name, params in FILTERS.items():
        seeds = LOG_SEEDS[:1] if params.sensor == "beam" else LOG_SEEDS
        rows.append(
            {"filter": name, **medians([measure_filter(drive, read.lidar, grid, params, seed) for seed in seeds])}
        )
    return rows


def load_reference(path: Path, num_scans: int | None = None) -> tuple[Log, Drive]:
    """Read the first scans of a log, None for all, with their reference poses, which begin at the origin."""
    log = load_log(path)
    log = replace(log, scan_rows=log.scan_rows[:num_scans], ranges=log.ranges[:num_scans])
    with np.load(path) as arrays:
        corrected = arrays["corr"][log.scan_rows]
    origin = Pose2D(*corrected[0])
    reference = np.array([origin.between(Pose2D(*row)) for row in corrected.tolist()])
    return log, Drive(log.ranges, np.array(list(log.motions())), reference)


def reference_map(log: Log, reference: np.ndarray) -> OccupancyGrid:
    """Draw a log at reference poses, shape (m, 3) [m, rad], seen from the first one, which becomes the origin."""
    mapper = KnownPoses(log.lidar, HIT_COUNTS)
    mapper.reset(np.random.default_rng(0))
    poses = [Pose2D(0.0, 0.0, 0.0), *(Pose2D(*row) for row in reference.tolist())]
    for ranges, (before, pose) in zip(log.ranges, itertools.pairwise(poses)):
        mapper.update(Reading.of_scan(ranges), before.between(pose))
    grid = mapper.belief.grid
    data = np.where(grid.data >= SHARE_OF_HITS, OCCUPIED, np.minimum(grid.data, 0)).astype(np.int8)
    return OccupancyGrid(data, grid.resolution, grid.origin)


def measure_filter(drive: Drive, lidar: LidarParams, grid: OccupancyGrid, params: AmclParams, seed: int) -> Row:
    """Track the robot of a log along its raw odometry from the first reference pose on, on a map in their frame.

    Returns errors over all scans against the reference, time of an update and number of particles.
    """
    done = localize(Amcl(lidar, params), grid, drive, seed, LOG_START_STD)
    distance, angle = pose_errors(done.poses, drive.truth)
    return {
        "position_rmse_m": rms(distance),
        "position_median_m": float(np.median(distance)),
        "position_max_m": float(distance.max()),
        "heading_rmse_deg": math.degrees(rms(angle)),
        "update_us": 1e6 * float(np.median(done.seconds[done.is_corrected])),
        "particles": float(np.mean(done.num_particles[done.is_corrected])),
        "lost_share": float(np.mean(done.is_lost)),
    }


def time_amcl(picture: Path | None = None) -> list[Row]:
    """Time of AMCL's updates [us] on one core: by number of particles, and as they fall in a global localization.

    Particles are those of 60 beams that all return: the lidar of the house's robot gets a range of 15 m.

    Args:
        picture: also draw particles, errors and cost to this file.
    """
    house = load_known_world("turtlebot3_house")
    rows = update_times(house)
    when, sizes, spent = cost = cost_by_size(house, 1)
    for k in sorted({0, 1, 2, 4, 8, 16, len(sizes) - 1} & set(range(len(sizes)))):
        what = f"global localization, scan {k + 1}, {when[k]:.1f} s"
        rows.append({"what": what, "particles": int(sizes[k]), "update_us": float(spent[k])})
    if picture is not None:
        draw(house, 1, cost, picture)
    return rows


def update_times(setup: Setup) -> list[Row]:
    """Time whole updates and their steps for fixed numbers of particles, pinned to one core."""
    lidar = replace(setup.robot.lidar, range_max=15.0)
    setup = setup._replace(robot=replace(setup.robot, lidar=lidar))
    grid, drive = known_map(setup.area), record_from_anywhere(setup, np.random.SeedSequence(0), 30.0)
    cores = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else None
    if cores is not None:
        os.sched_setaffinity(0, {min(cores)})
    spent: dict[tuple[int, str], list[tuple[float, float]]] = {}
    for n, sensor in [*itertools.product((1000, 2000), ("likelihood_field", "likelihood_field_prob"))] * REPEATS:
        params = replace(PRESETS["nav2"], min_particles=n, max_particles=n, sensor=sensor)
        steps = _time_steps(grid, lidar, drive, params)
        params = replace(params, update_min_d=0.0, update_min_a=0.0)  # so that every scan is used
        whole = localize(Amcl(lidar, params), grid, drive, 0, START_STD).seconds
        spent.setdefault((n, sensor), []).append((np.median(steps[20:]), np.median(whole[20:])))
    if cores is not None:
        os.sched_setaffinity(0, cores)
    return [
        {"what": sensor, "particles": n, **dict(zip(("steps_us", "update_us"), 1e6 * np.median(times, axis=0)))}
        for (n, sensor), times in spent.items()
    ]


def _time_steps(grid: OccupancyGrid, lidar: LidarParams, drive: Drive, params: AmclParams) -> list[float]:
    """Return the times of propagating, weighting and resampling alone [s], without the estimate."""
    weigh, particles, rng = LikelihoodField(params, lidar, grid), params.max_particles, np.random.default_rng(0)
    cloud = (drive.truth[0] + START_STD * rng.standard_normal((particles, 3))).T.astype(np.float32).copy()
    other, none = np.empty_like(cloud), np.empty((3, 0), dtype=np.float32)
    bins, seen, kld = np.zeros(particles, dtype=np.int32), np.zeros(1, dtype=bool), (particles, 0.05, 0.99)
    spent = []
    for ranges, motion in zip(drive.ranges, drive.motions.tolist()):
        began = time.perf_counter()
        move_particles(cloud, Pose2D(*motion), params, rng)
        weights = np.full(particles, 1.0 / particles)
        weigher = weigh(ranges)
        assert weigher is not None
        weigher(cloud, weights)
        weights /= weights.sum()
        resample(cloud, weights, bins, rng.random(), kld, none, 0.0, seen, other)
        cloud, other = other, cloud
        spent.append(time.perf_counter() - began)
    return spent


def cost_by_size(setup: Setup, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time the updates of the default preset during global localization.

    Returns:
        For each scan that was used: its time [s], the number of particles that were weighted, and the time of the
        update [us].
    """
    drive, params = record_from_anywhere(setup, np.random.SeedSequence(seed), 30.0), PRESETS["default"]
    amcl, grid = Amcl(setup.robot.lidar, params), known_map(setup.area)
    localize(amcl, grid, drive, seed, None)  # compiles the kernels
    done = localize(amcl, grid, drive, seed, None)
    weighted, used = np.concatenate([[params.most_particles], done.num_particles[:-1]]), done.is_corrected
    return PERIOD * np.flatnonzero(used), weighted[used], 1e6 * done.seconds[used]


def draw(setup: Setup, seed: int, cost: tuple[np.ndarray, np.ndarray, np.ndarray], path: Path) -> None:
    """Draw particles during global localization, errors of a kidnapped robot over time, and cost (`cost_by_size`)."""
    figure, grid = Figure(figsize=(15, 7.6), layout="constrained"), known_map(setup.area)
    axes = figure.subplot_mosaic("0123;eecc")
    amcl = Amcl(setup.robot.lidar, PRESETS["default"])
    _draw_particles([axes[key] for key in "0123"], setup, grid, amcl, seed)

    first, second = np.random.SeedSequence(seed).spawn(2)
    drive = record_from_anywhere(setup, first, KIDNAPPED_AT)
    drive = drive.then(record_from_anywhere(setup, second, 40.0), round(KIDNAPPED_AT / PERIOD))
    done, ax = localize(amcl, grid, drive, seed, START_STD), axes["e"]
    times = PERIOD * np.arange(len(done.poses))
    ax.semilogy(times, pose_errors(done.poses, drive.truth)[0], color="tab:blue", label="error of the position [m]")
    ax.semilogy(times, done.fit, color="tab:green", linewidth=1, label="fit: share of hits that the map explains")
    low, high = ax.get_ylim()
    ax.fill_between(times, low, high, where=done.is_lost, color="tab:orange", alpha=0.3, linewidth=0, label="lost")
    ax.set_ylim(low, high)
    ax.axvline(KIDNAPPED_AT, color="grey", linestyle=":")
    ax.set(xlabel="time [s]", title=f"kidnapped after {KIDNAPPED_AT:g} s")
    ax.legend(loc="lower right", fontsize=8)

    when, sizes, spent = cost
    ax = axes["c"]
    ax.semilogy(when, sizes, ".-", color="tab:blue", label="particles weighted")
    ax.semilogy(when, spent, ".-", color="tab:red", label="time of the update [us]")
    ax.set(xlabel="time [s]", title="cost follows the number of particles")
    ax.legend(fontsize=8)
    figure.savefig(path, dpi=80)


def _draw_particles(axes: Sequence[Any], setup: Setup, grid: OccupancyGrid, amcl: Amcl, seed: int) -> None:
    drive = record_from_anywhere(setup, np.random.SeedSequence(seed), max(PARTICLE_TIMES))
    amcl.reset(np.random.default_rng(seed), None, grid)
    x_min, y_min, x_max, y_max = grid.bounds
    ax_at = dict(zip((round(time / PERIOD) for time in PARTICLE_TIMES), axes))
    for k, (ranges, motion) in enumerate(zip(drive.ranges, drive.motions.tolist())):
        if k in ax_at:
            ax, particles = ax_at[k], amcl.particles
            shown = particles[:: max(1, len(particles) // 4000)]
            shades, extent = np.where(grid.data < 0, 60, grid.data), (x_min, x_max, y_min, y_max)
            ax.imshow(shades, cmap="Greys", origin="lower", extent=extent, vmax=160)
            ax.scatter(shown[:, 0], shown[:, 1], s=2, color="tab:blue", linewidths=0)
            ax.plot(*drive.truth[k, :2], "o", color="tab:red", markersize=7, markerfacecolor="none")
            ax.set_title(f"{k * PERIOD:g} s: {len(particles):,} particles")
            ax.set_axis_off()
        amcl.update(Reading.of_scan(ranges), Pose2D(*motion))

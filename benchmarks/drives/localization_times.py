"""Benchmark of AMCL's update times."""

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from lidarnaut.benchmarks.drives.localization import (
    KIDNAPPED_AT,
    START_STD,
    load_known_world,
    localize,
    record_from_anywhere,
)
from lidarnaut.benchmarks.drives.recording import PERIOD, Row, Setup
from lidarnaut.envs.geometry import Pose2D
from lidarnaut.envs.localization import PRESETS, Amcl
from lidarnaut.envs.logs import trajectory_errors
from lidarnaut.envs.simulation import Reading
from lidarnaut.envs.tasks.goals import known_map

REPEATS = 5
PARTICLE_TIMES = {"0": 0.0, "1": 0.2, "2": 3.0, "3": 15.0}


def time_amcl(picture: Path | None = None) -> list[Row]:
    """Measure the time of an AMCL update [us] by number of particles, and during global localization.

    Args:
        picture: also plot particles, errors of a kidnapped robot, and update times to this file.
    """
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
    when, sizes, spent_on = cost = cost_by_size(house, 1)
    for k in sorted({0, 1, 2, 4, 8, 16, len(sizes) - 1} & set(range(len(sizes)))):
        what = f"global localization, scan {k + 1}, {when[k]:.1f} s"
        rows.append({"what": what, "particles": int(sizes[k]), "update_us": float(spent_on[k])})
    if picture is not None:
        draw(house, 1, cost, picture)
    return rows


def cost_by_size(setup: Setup, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Simulate global localization; return time [s], number of particles, and duration [us] of each AMCL update."""
    drive, params = record_from_anywhere(setup, np.random.SeedSequence(seed), 30.0), PRESETS["default"]
    amcl, grid = Amcl(setup.robot.lidar, params), known_map(setup.area)
    localize(amcl, grid, drive, seed, None)  # compiles
    done = localize(amcl, grid, drive, seed, None)
    weighted, used = np.concatenate([[params.most_particles], done["num_particles"][:-1]]), done["is_corrected"]
    return PERIOD * np.flatnonzero(used), weighted[used], 1e6 * done["seconds"][used]


def draw(setup: Setup, seed: int, cost: tuple[np.ndarray, np.ndarray, np.ndarray], path: Path) -> None:
    figure, grid = Figure(figsize=(15, 7.6), layout="constrained"), known_map(setup.area)
    axes, amcl = figure.subplot_mosaic("0123;eecc"), Amcl(setup.robot.lidar, PRESETS["default"])
    seeds, kidnapped_at = np.random.SeedSequence(seed), round(KIDNAPPED_AT / PERIOD)
    first, second = seeds.spawn(2)

    drive = record_from_anywhere(setup, np.random.SeedSequence(seed), max(PARTICLE_TIMES.values()))
    amcl.reset(np.random.default_rng(seed), None, grid)
    x_min, y_min, x_max, y_max = grid.bounds
    panels = {round(time / PERIOD): axes[key] for key, time in PARTICLE_TIMES.items()}
    for k, (ranges, motion) in enumerate(zip(drive.ranges, drive.motions.tolist())):
        if ax := panels.get(k):
            shown = amcl.particles[:: max(1, amcl.num_particles // 4000)]
            shades, extent = np.where(grid.data < 0, 60, grid.data), (x_min, x_max, y_min, y_max)
            ax.imshow(shades, cmap="Greys", origin="lower", extent=extent, vmax=160)
            ax.scatter(shown[:, 0], shown[:, 1], s=2, color="tab:blue", linewidths=0)
            ax.plot(*drive.truth[k, :2], "o", color="tab:red", markersize=7, markerfacecolor="none")
            ax.set_title(f"{k * PERIOD:g} s: {amcl.num_particles:,} particles")
            ax.set_axis_off()
        amcl.update(Reading.of_scan(ranges), Pose2D(*motion))

    drive = record_from_anywhere(setup, first, KIDNAPPED_AT)
    drive = drive.then(record_from_anywhere(setup, second, 40.0), kidnapped_at)
    done, ax = localize(amcl, grid, drive, seed, START_STD), axes["e"]
    times = PERIOD * np.arange(len(done["poses"]))
    ax.semilogy(
        times, trajectory_errors(done["poses"], drive.truth)[0], color="tab:blue", label="error of the position [m]"
    )
    ax.semilogy(times, done["fit"], color="tab:green", linewidth=1, label="fit: share of hits that the map explains")
    low, high = ax.get_ylim()
    ax.fill_between(times, low, high, where=done["is_lost"], color="tab:orange", alpha=0.3, linewidth=0, label="lost")
    ax.axvline(KIDNAPPED_AT, color="grey", linestyle=":")
    ax.set(xlabel="time [s]", ylim=(low, high), title=f"kidnapped after {KIDNAPPED_AT:g} s")
    ax.legend(loc="lower right", fontsize=8)

    when, sizes, spent = cost
    ax = axes["c"]
    ax.semilogy(when, sizes, ".-", color="tab:blue", label="particles weighted")
    ax.semilogy(when, spent, ".-", color="tab:red", label="time of the update [us]")
    ax.set(xlabel="time [s]", title="cost follows the number of particles")
    ax.legend(fontsize=8)
    figure.savefig(path, dpi=80)

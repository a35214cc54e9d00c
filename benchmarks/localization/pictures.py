"""Figure of the localization benchmark."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks.recorded_drives import PERIOD
from envs.geometry import Pose2D
from envs.localization import PRESETS, Amcl
from envs.logs import pose_errors
from envs.simulation import Reading

from .maps import KnownWorld, record_from_anywhere
from .runs import KIDNAPPED_AT, START_STD, localize

PARTICLE_TIMES = (0.0, 0.2, 3.0, 15.0)
"""Times at which particles are shown [s]."""


def draw(known: KnownWorld, seed: int, cost: tuple[np.ndarray, np.ndarray, np.ndarray], path: Path) -> None:
    """Draw particles during global localization, errors of a kidnapped robot over time, and cost (`cost_by_size`)."""
    figure = Figure(figsize=(15, 7.6), layout="constrained")
    axes = figure.subplot_mosaic("0123;eecc")
    _draw_particles([axes[key] for key in "0123"], known, seed)
    _draw_error(axes["e"], known, seed)
    _draw_cost(axes["c"], cost)
    figure.savefig(path, dpi=80)


def _draw_particles(axes, known: KnownWorld, seed: int) -> None:
    drive = record_from_anywhere(known.setup, np.random.SeedSequence(seed), max(PARTICLE_TIMES))
    amcl = Amcl(known.setup.robot.lidar, PRESETS["default"])
    amcl.reset(np.random.default_rng(seed), None, known.grid)
    x_min, y_min, x_max, y_max = known.grid.bounds
    ax_at = dict(zip((round(time / PERIOD) for time in PARTICLE_TIMES), axes))
    for k, (ranges, motion) in enumerate(zip(drive.ranges, drive.motions.tolist())):
        if k in ax_at:
            ax, particles = ax_at[k], amcl.particles
            shown = particles[:: max(1, len(particles) // 4000)]
            shades, extent = np.where(known.grid.data < 0, 60, known.grid.data), (x_min, x_max, y_min, y_max)
            ax.imshow(shades, cmap="Greys", origin="lower", extent=extent, vmax=160)
            ax.scatter(shown[:, 0], shown[:, 1], s=2, color="tab:blue", linewidths=0)
            ax.plot(*drive.truth[k, :2], "o", color="tab:red", markersize=7, markerfacecolor="none")
            ax.set_title(f"{k * PERIOD:g} s: {len(particles):,} particles")
            ax.set_axis_off()
        amcl.update(Reading.of_scan(ranges), Pose2D(*motion))


def _draw_error(ax, known: KnownWorld, seed: int) -> None:
    first, second = np.random.SeedSequence(seed).spawn(2)
    scans = round(KIDNAPPED_AT / PERIOD)
    drive = record_from_anywhere(known.setup, first, KIDNAPPED_AT)
    drive = drive.then(record_from_anywhere(known.setup, second, 40.0), scans)
    track = localize(Amcl(known.setup.robot.lidar, PRESETS["default"]), known.grid, drive, seed, START_STD)
    position = pose_errors(track.poses, drive.truth)[0]
    times = PERIOD * np.arange(len(position))
    ax.semilogy(times, position, color="tab:blue", label="error of the position [m]")
    ax.semilogy(times, track.fit, color="tab:green", linewidth=1, label="fit: share of hits that the map explains")
    low, high = ax.get_ylim()
    ax.fill_between(times, low, high, where=track.is_lost, color="tab:orange", alpha=0.3, linewidth=0, label="lost")
    ax.set_ylim(low, high)
    ax.axvline(KIDNAPPED_AT, color="grey", linestyle=":")
    ax.set(xlabel="time [s]", title=f"kidnapped after {KIDNAPPED_AT:g} s")
    ax.legend(loc="lower right", fontsize=8)


def _draw_cost(ax, cost: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    when, sizes, spent = cost
    ax.semilogy(when, sizes, ".-", color="tab:blue", label="particles weighted")
    ax.semilogy(when, spent, ".-", color="tab:red", label="time of the update [us]")
    ax.set(xlabel="time [s]", title="cost follows the number of particles")
    ax.legend(fontsize=8)

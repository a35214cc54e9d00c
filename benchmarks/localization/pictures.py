"""Pictures of localisation."""

from pathlib import Path

import numpy as np

from envs.geometry import Pose2D
from envs.localization import PRESETS, Amcl

from .drives import PERIOD, Place, record
from .runs import CARRIED_OFF_AT, START_STD, errors

CLOUD_TIMES = (0.0, 0.2, 3.0, 15.0)
"""When the cloud is drawn [s]."""


def draw(place: Place, seed: int, cost: tuple[np.ndarray, np.ndarray, np.ndarray], path: Path) -> None:
    """Draw clouds of a robot that wakes up anywhere, the error over time of one that is carried off, and cost by size.

    Args:
        place: where.
        seed: of drives and noise.
        cost: from `cost_by_size`.
        path: where to.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(2, 4, figsize=(15, 7.6), layout="constrained")
    _draw_clouds(axes[0], place, seed)
    grid = axes[1, 0].get_gridspec()
    for ax in axes[1]:
        ax.remove()
    _draw_error(figure.add_subplot(grid[1, :2]), place, seed)
    _draw_cost(figure.add_subplot(grid[1, 2:]), cost)
    figure.savefig(path, dpi=80)
    plt.close(figure)


def _draw_clouds(axes, place: Place, seed: int) -> None:
    drive = record(place, np.random.SeedSequence(seed), max(CLOUD_TIMES), "kinematic")
    amcl = Amcl(place.robot.lidar, PRESETS["default"])
    amcl.reset(place.grid, None, np.random.default_rng(seed))
    x_min, y_min, x_max, y_max = place.grid.bounds
    ax_at = dict(zip((round(time / PERIOD) for time in CLOUD_TIMES), axes))
    for k, (ranges, motion) in enumerate(zip(drive.ranges, drive.motions.tolist())):
        if k in ax_at:
            ax, cloud = ax_at[k], amcl.particles
            shown = cloud[:: max(1, len(cloud) // 4000)]
            ax.imshow(
                np.where(place.grid.data < 0, 60, place.grid.data),
                cmap="Greys",
                origin="lower",
                extent=(x_min, x_max, y_min, y_max),
                vmax=160,
            )
            ax.scatter(shown[:, 0], shown[:, 1], s=2, color="tab:blue", linewidths=0)
            ax.plot(*drive.truth[k, :2], "o", color="tab:red", markersize=7, markerfacecolor="none")
            ax.set_title(f"{k * PERIOD:g} s: {len(cloud):,} particles")
            ax.set_axis_off()
        amcl.update(ranges, Pose2D(*motion))


def _draw_error(ax, place: Place, seed: int) -> None:
    first, second = np.random.SeedSequence(seed).spawn(2)
    scans = round(CARRIED_OFF_AT / PERIOD)
    drive = record(place, first, CARRIED_OFF_AT, "kinematic").then(record(place, second, 40.0, "kinematic"), scans)
    amcl = Amcl(place.robot.lidar, PRESETS["default"])
    start = Pose2D(*drive.truth[0])
    amcl.reset(place.grid, start, np.random.default_rng(seed), covariance=np.diag(np.square(START_STD)))
    poses, lost, fits = [], [], []
    for ranges, motion in zip(drive.ranges, drive.motions.tolist()):
        estimate = amcl.update(ranges, Pose2D(*motion))
        poses.append(estimate.pose)
        lost.append(estimate.is_lost)
        fits.append(estimate.fit)
    times = PERIOD * np.arange(len(poses))
    ax.semilogy(times, errors(np.array(poses), drive.truth)[0], color="tab:blue", label="error of the position [m]")
    ax.semilogy(times, fits, color="tab:green", linewidth=1, label="fit: share of hits that the map explains")
    low, high = ax.get_ylim()
    ax.fill_between(times, low, high, where=lost, color="tab:orange", alpha=0.3, linewidth=0, label="says it is lost")
    ax.set_ylim(low, high)
    ax.axvline(CARRIED_OFF_AT, color="grey", linestyle=":")
    ax.set(xlabel="time [s]", title=f"carried off after {CARRIED_OFF_AT:g} s")
    ax.legend(loc="lower right", fontsize=8)


def _draw_cost(ax, cost: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    when, sizes, spent = cost
    ax.semilogy(when, sizes, ".-", color="tab:blue", label="particles weighed")
    ax.semilogy(when, spent, ".-", color="tab:red", label="time of the update [us]")
    ax.set(xlabel="time [s]", title="cost follows the size of the cloud")
    ax.legend(fontsize=8)

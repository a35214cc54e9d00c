"""Figures 5 to 10 of Nguyen et al. (2021), from our drives."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from benchmarks.arena.theme import LIGHT

from .drive import DRIVER, PAPER, Drive, make_env

COLOURS = {"encoder": LIGHT.lines[1], "amcl": LIGHT.lines[2], "encoder_compass": LIGHT.lines[3], "full": LIGHT.lines[0]}


def draw_figures(drives: Sequence[Drive], labels: Mapping[str, str], folder: Path) -> None:
    """Draw `ekf_position.png`, `ekf_heading.png` and `ekf_errors.png` into a folder; labels name the fusions.

    Drives may be of several physics; figures of one drive show the first.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with matplotlib.rc_context({"axes.spines.top": False, "axes.spines.right": False, "font.size": 9}):
        _draw_position(drives[0], labels).savefig(folder / "ekf_position.png", dpi=110)
        _draw_heading(drives[0], labels).savefig(folder / "ekf_heading.png", dpi=110)
        _draw_errors(drives, labels).savefig(folder / "ekf_errors.png", dpi=110)


def _draw_position(drive: Drive, labels: Mapping[str, str]) -> Figure:
    """Figures 5 and 6: the map made beforehand, the true and the estimated paths."""
    env = make_env(drive.physics, map_seed=drive.seed)
    env.reset(seed=drive.seed)
    grid = env.belief.grid
    env.close()
    known = np.argwhere(grid.data >= 0)
    (bottom, left), (top, right) = known.min(axis=0), known.max(axis=0) + 1
    shades = np.where(grid.data < 0, 0.82, 1.0 - grid.data / 100.0)[bottom:top, left:right]
    x, y = grid.origin
    extent = (x + left * grid.resolution, x + right * grid.resolution)
    extent += (y + bottom * grid.resolution, y + top * grid.resolution)
    figure = Figure(figsize=(10, 7.4), layout="constrained")
    axes = figure.subplots()
    axes.imshow(shades, cmap="gray", origin="lower", extent=extent, vmin=0, vmax=1, interpolation="antialiased")
    for fusion, label in labels.items():
        axes.plot(*drive.estimated[fusion][:, :2].T, color=COLOURS[fusion], lw=1.6, label=label)
    axes.plot(*drive.truth[:, :2].T, color=LIGHT.ink, lw=0.8, ls="--", label="truth")
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axes.set_title(
        f"Position on the map made beforehand ({drive.physics} physics, seed {drive.seed}); the paper's 5 and 6"
    )
    figure.legend(loc="outside lower center", ncols=5, frameon=False)
    return figure


def _draw_heading(drive: Drive, labels: Mapping[str, str]) -> Figure:
    """Figure 7: the heading over time."""
    figure = Figure(figsize=(10, 3.6), layout="constrained")
    axes = figure.subplots()
    for fusion, label in labels.items():
        axes.plot(drive.time, np.degrees(np.unwrap(drive.estimated[fusion][:, 2])), color=COLOURS[fusion], label=label)
    axes.plot(drive.time, np.degrees(np.unwrap(drive.truth[:, 2])), color=LIGHT.ink, lw=0.8, ls="--", label="truth")
    axes.set(xlabel="time [s]", ylabel="heading [deg]", yticks=range(0, 361, 90))
    axes.set_title(f"Heading ({drive.physics} physics, seed {drive.seed}); the paper's figure 7")
    axes.legend(frameon=False)
    return figure


def _draw_errors(drives: Sequence[Drive], labels: Mapping[str, str]) -> Figure:
    """Figures 8 to 10: errors of the localizer alone and of the full fusion, all drives, and the paper's greatest."""
    physics = list(dict.fromkeys(drive.physics for drive in drives))
    figure = Figure(figsize=(5.2 * len(physics), 7.4), layout="constrained")
    grid = figure.subplots(3, len(physics), sharex="col", sharey="row", squeeze=False)
    rows = (("x error [mm]", 1e3, "max_x"), ("y error [mm]", 1e3, "max_y"), ("heading error [deg]", 180 / np.pi, ""))
    for k, (label, scale, key) in enumerate(rows):
        for axes, name in zip(grid[k], physics):
            for fusion in ("amcl", DRIVER):
                for drive in (drive for drive in drives if drive.physics == name):
                    error = scale * drive.error(fusion)[:, k]
                    axes.plot(drive.time, error, color=COLOURS[fusion], lw=0.7, alpha=0.3)
                axes.plot([], [], color=COLOURS[fusion], label=labels[fusion])
            bound = scale * PAPER[key] if key else PAPER["heading_rmse"]
            what = "paper's greatest error" if key else "paper's RMSE (its greatest error is 3.3)"
            axes.axhline(bound, color=LIGHT.error, lw=1.0, ls=":", label=what)
            axes.axhline(-bound, color=LIGHT.error, lw=1.0, ls=":")
            axes.axhline(0.0, color=LIGHT.muted, lw=0.6)
        grid[k, 0].set_ylabel(label)
        grid[k, -1].legend(loc="upper right", fontsize=7, framealpha=0.8)
    for axes, name in zip(grid[0], physics):
        axes.set_title(f"{name} physics, drives: {sum(drive.physics == name for drive in drives)}")
    for axes in grid[-1]:
        axes.set_xlabel("time [s]")
    figure.suptitle("Errors of AMCL alone and of the full fusion; the paper's figures 8 to 10")
    return figure

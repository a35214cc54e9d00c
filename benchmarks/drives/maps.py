"""Maps of all SLAMs side by side, of a drive and of the Intel Research Lab."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from PIL import Image
from scipy import ndimage

from benchmarks.drives.recording import DATA, LOG, RELATIONS, RESOLUTION, Row, make_setup, record_drive, track
from benchmarks.drives.slams import run_on_log
from envs.geometry import UNKNOWN, OccupancyGrid, Pose2D
from envs.logs import load_log, load_relations, pose_errors, rms
from envs.rendering import style
from envs.robots import load_robot
from envs.slam import make_slam
from envs.tasks.coverage import map_iou
from envs.worlds import load_world

NAMES = {
    "odometry": "Raw odometry",
    "tinyslam": "TinySLAM",
    "hector": "Hector",
    "gmapping": "GMapping",
    "graph": "Graph SLAM",
}
"""SLAMs in the order of the panels, and what their titles call them."""
NEAR = 0.15
"""Distance from a true wall up to which a wall of a map is where it should be [m]."""
MARGIN = 0.5
"""Around what is shown [m]."""
COLUMNS, WIDTH = 3, 10.5
"""Panels in a row; width of a picture [in]."""
COMMENT = """\
The same scans and the same odometry
for all. Numbers: mean error of relative
positions that people verified by hand
(Kümmerle et al., 2009)."""
PATH, WRONG = style.TRUE, style.ESTIMATED


class Panel(NamedTuple):
    """One map in a picture."""

    title: str
    grid: OccupancyGrid
    poses: np.ndarray
    """Shape (n, >= 2): a path [m]."""
    wrong: np.ndarray | None = None
    """Shape of the map, bool: walls that are not where they should be."""


def draw_maps(
    out: Path = Path("docs/images"),
    world: str = "workshop_hall",
    robot: str = "turtlebot3_waffle_pi",
    seed: int = 0,
    minutes: float = 20.0,
) -> list[Row]:
    """Pictures of the maps of all SLAMs: `slam_maps.png` of a drive between random goals beside ground truth.

    And `slam_maps_intel.png` of the Intel log with the SLAMs' preset `intel`, if it lies in `$LIDARNAUT_DATA/intel`.

    Args:
        out: folder of the pictures.
        world: library world, or path of a world file.
        robot: library robot, or path of a robot file.
        seed: of goals, noise and SLAMs.
        minutes: length of the drive [min].
    """
    out.mkdir(parents=True, exist_ok=True)
    setup = make_setup(load_world(world), load_robot(robot), "kinematic")
    drive, walls = record_drive(setup, seed, 60.0 * minutes), setup.area.walls
    panels, rows = [Panel("Ground truth, and the path driven", walls, drive.truth)], list[Row]()
    for name, title in NAMES.items():
        slam = make_slam(name, setup.robot.lidar, RESOLUTION, odometry_noise=setup.robot.odometry.noise)
        slam.reset(np.random.default_rng(seed), setup.world.spawns[0])  # the map frame is the world's
        poses, grid = track(slam, drive)[0], slam.belief.grid
        iou, error = map_iou(grid, setup.area, Pose2D(0.0, 0.0, 0.0)), rms(pose_errors(poses, drive.truth)[0])
        panels.append(Panel(f"{title}: RMSE {error:.2f} m, map IoU {iou:.2f}", grid, poses, wrong_cells(grid, walls)))
        rows.append({"slam": name, "data": world, "translation_m": error, "map_iou": iou})
    length = np.hypot(*np.diff(drive.truth[:, :2], axis=0).T).sum()
    note = (
        f"{world}: {setup.robot.name}, {setup.robot.lidar.range_max:g} m lidar, {length:.0f} m in {minutes:g} minutes"
    )
    legend = {"wall": style.OCCUPIED, f"wall more than {NEAR:g} m off": WRONG, "path": PATH}
    _draw(out / "slam_maps.png", panels, np.reshape(walls.known_part().bounds, (2, 2)), note, legend)
    if not LOG.is_file():
        print(f"the Intel log is not at {DATA}; set LIDARNAUT_DATA")
        return rows
    return rows + draw_log(out / "slam_maps_intel.png", seed)


def draw_log(path: Path, seed: int) -> list[Row]:
    """Draw the map of each SLAM of the Intel log, with the final poses and their relation error."""
    log, relations = load_log(LOG), {"error": load_relations(RELATIONS)}
    panels, rows = list[Panel](), list[Row]()
    for name, title in NAMES.items():
        slam, replayed, run = run_on_log(log, relations, name, seed)
        assert run.final_error is not None
        rows.append({"slam": name, "data": LOG.stem, "translation_m": run.final_error.translation})
        panels.append(Panel(f"{title}: {run.final_error.translation:.3f} m", slam.belief.grid, replayed.final))
    # The odometry's map is larger than the building, and would leave no room for it.
    inside = np.concatenate([panel.poses[:, :2] for row, panel in zip(rows, panels) if row["slam"] != "odometry"])
    bounds = np.array([inside.min(axis=0) - 5.0, inside.max(axis=0) + 5.0])
    legend = {"wall": style.OCCUPIED, "free": style.FREE, "unknown": style.UNKNOWN, "path": PATH}
    _draw(path, panels, bounds, f"Intel Research Lab, {len(log.ranges):,} scans, final maps and poses", legend, COMMENT)
    return rows


def _draw(
    path: Path,
    panels: Sequence[Panel],
    bounds: np.ndarray,
    note: str,
    legend: dict[str, style.Colour],
    comment: str = "",
) -> None:
    """Draw the same part of the plane in each panel at the same scale, with a scale bar, a note and a legend below.

    `bounds` are the least and the greatest x and y, shape (2, 2) [m]. A comment takes the place of the next panel.
    """
    (x_min, y_min), (x_max, y_max) = bounds + np.array([[-MARGIN], [MARGIN]])
    lines = -(-len(panels) // COLUMNS)
    height = lines * (WIDTH / COLUMNS * (y_max - y_min) / (x_max - x_min) + 0.3) + 0.4
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    figure.get_layout_engine().set(rect=(0.0, 0.4 / height, 1.0, 1.0 - 0.4 / height))
    axes = figure.subplots(lines, COLUMNS, squeeze=False).ravel()
    for ax in axes:
        ax.set_axis_off()
    for ax, (title, grid, poses, wrong) in zip(axes, panels):
        shade = np.clip(grid.data, 0, 100)[..., None] / 100.0
        colours = (1.0 - shade) * style.FREE + shade * style.OCCUPIED
        colours[grid.data == UNKNOWN] = style.UNKNOWN
        if wrong is not None:
            colours[ndimage.binary_dilation(wrong, iterations=2)] = WRONG
        left, low, right, high = grid.bounds
        ax.imshow(colours.astype(np.uint8), origin="lower", extent=(left, right, low, high))
        ax.plot(*poses[:, :2].T, color=_rgb(PATH), linewidth=0.5, alpha=0.7)
        size = x_max - x_min, y_max - y_min
        ax.add_patch(Rectangle((x_min, y_min), *size, facecolor=_rgb(style.UNKNOWN), zorder=-1))
        ax.set(xlim=(x_min, x_max), ylim=(y_min, y_max))
        ax.set_title(title, fontsize=10)
    if comment:
        look = {"fontsize": 10, "va": "top", "color": _rgb(style.INK), "linespacing": 1.5}
        axes[len(panels)].text(0.06, 0.9, comment, transform=axes[len(panels)].transAxes, **look)
    gap, length = 0.06 * (x_max - x_min), 5.0
    x, y = x_max - length - gap, y_min + gap
    axes[0].plot([x, x + length], [y, y], color=_rgb(style.INK), linewidth=3, solid_capstyle="butt")
    axes[0].text(x + 0.5 * length, y + 0.2 * gap, f"{length:g} m", ha="center", va="bottom", fontsize=9)
    marks = [Patch(facecolor=_rgb(colour), edgecolor="0.6", label=text) for text, colour in legend.items()]
    figure.text(0.01, 0.2 / height, note, fontsize=9, va="center")
    figure.legend(handles=marks, loc="center right", bbox_to_anchor=(0.995, 0.2 / height), ncols=4, fontsize=8)
    figure.savefig(path, dpi=100)
    with Image.open(path) as image:
        small = image.convert("RGB").quantize(96, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    small.save(path, optimize=True)


def wrong_cells(grid: OccupancyGrid, walls: OccupancyGrid) -> np.ndarray:
    """Return which cells of a map, world frame, are occupied and lie more than `NEAR` from true walls, or outside."""
    distance = ndimage.distance_transform_edt(walls.data == 0) * walls.resolution
    occupied = np.argwhere(grid.data >= 65)
    cells = walls.cells(grid.centers(occupied))
    is_wrong = ~walls.contains(cells)
    is_wrong[~is_wrong] = distance[tuple(cells[~is_wrong].T)] > NEAR
    wrong = np.zeros(grid.data.shape, dtype=np.bool_)
    wrong[tuple(occupied[is_wrong].T)] = True
    return wrong


def _rgb(colour: style.Colour) -> tuple[float, ...]:
    return tuple(part / 255 for part in colour)

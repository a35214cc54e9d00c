"""Maps of all SLAMs side by side, of a drive and of the Intel Research Lab: `python -m benchmarks.slam_maps`."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from PIL import Image
from scipy import ndimage

from benchmarks.recorded_drives import RESOLUTION, make_setup, record_drive, track
from envs.command_line import run_command
from envs.estimation import Estimator
from envs.geometry import UNKNOWN, OccupancyGrid, Pose2D
from envs.logs import load_log, load_relations, pose_errors, rms
from envs.logs.runs import measure, replay
from envs.rendering import style
from envs.robots import load_robot
from envs.slam import SLAMS, make_slam
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
COLUMNS, WIDTH, DPI = 3, 10.5, 100
"""Panels in a row; width of a picture [in]; pixels per inch."""
COMMENT = """\
The same scans and the same odometry
for all. Numbers: mean error of relative
positions that people verified by hand
(Kümmerle et al., 2009)."""
PATH, WRONG = style.TRUE, style.ESTIMATED
Bounds = tuple[float, float, float, float]
"""x_min, y_min, x_max, y_max [m]."""


def draw_drive(path: Path, world: str, robot: str, seed: int, minutes: float) -> None:
    """Draw ground truth, and the map of each SLAM on one drive between random goals, kinematic physics.

    Args:
        path: of the picture.
        world: library world, or path of a world file.
        robot: library robot, or path of a robot file.
        seed: of goals, noise and SLAMs.
        minutes: length of the drive [min].
    """
    setup = make_setup(load_world(world), load_robot(robot), "kinematic")
    drive, walls = record_drive(setup, seed, 60.0 * minutes), setup.area.walls
    panels = _Panels(1 + len(NAMES), _around([walls.known_part().bounds]))
    panels.add("Ground truth, and the path driven", walls, drive.truth)
    far = ndimage.distance_transform_edt(walls.data == 0) > NEAR / walls.resolution
    for name, title in NAMES.items():
        slam = make_slam(name, setup.robot.lidar, RESOLUTION, odometry_noise=setup.robot.odometry.noise)
        slam.reset(np.random.default_rng(seed), setup.world.spawns[0])  # the map frame is the world's
        poses = track(slam, drive).poses
        grid, iou = slam.belief.grid, map_iou(slam.belief.grid, setup.area, Pose2D(0.0, 0.0, 0.0))
        error = rms(pose_errors(poses, drive.truth)[0])
        panels.add(f"{title}: RMSE {error:.2f} m, map IoU {iou:.2f}", grid, poses, wrong_cells(grid, walls, far))
    length = np.hypot(*np.diff(drive.truth[:, :2], axis=0).T).sum()
    robot_name, reach = setup.robot.name, setup.robot.lidar.range_max
    note = f"{world}: {robot_name}, {reach:g} m lidar, {length:.0f} m in {minutes:g} minutes"
    panels.save(path, note, {"wall": style.OCCUPIED, f"wall more than {NEAR:g} m off": WRONG, "path": PATH})


def draw_log(path: Path, log_path: Path, relations_path: Path, seed: int) -> None:
    """Draw the map of each SLAM of a log with its preset `intel`, with the final poses and their relation error."""
    log, relations = load_log(log_path), {"error": load_relations(relations_path)}
    results: list[tuple[str, Estimator, np.ndarray]] = []
    for name, title in NAMES.items():
        params = SLAMS[name].load("intel")
        slam = make_slam(name, log.lidar, params.resolution, params)
        replayed = replay(log, slam, seed)
        error = measure(log, slam, name, seed, replayed, relations).final_error
        assert error is not None
        results.append((f"{title}: {error.translation:.3f} m", slam, replayed.final))
    # The odometry's map is larger than the building, and would leave no room for it.
    bounds = _around([_extent(poses, 5.0) for title, _, poses in results if not title.startswith(NAMES["odometry"])])
    panels = _Panels(len(results), bounds)
    for title, slam, poses in results:
        panels.add(title, slam.belief.grid, poses)
    panels.comment(COMMENT)
    note = f"Intel Research Lab, {len(log.ranges):,} scans, final maps and poses"
    panels.save(path, note, {"wall": style.OCCUPIED, "free": style.FREE, "unknown": style.UNKNOWN, "path": PATH})


class _Panels:
    """Panels of the same part of the plane at the same scale."""

    def __init__(self, count: int, bounds: Bounds) -> None:
        self._bounds = bounds
        x_min, y_min, x_max, y_max = bounds
        rows = -(-count // COLUMNS)
        height = rows * (WIDTH / COLUMNS * (y_max - y_min) / (x_max - x_min) + 0.3) + 0.4
        self._figure = Figure(figsize=(WIDTH, height), layout="constrained")
        self._figure.get_layout_engine().set(rect=(0.0, 0.4 / height, 1.0, 1.0 - 0.4 / height))
        self._axes: list[Axes] = list(self._figure.subplots(rows, COLUMNS, squeeze=False).ravel())
        self._height, self._count = height, 0
        for ax in self._axes:
            ax.set_axis_off()

    def add(self, title: str, grid: OccupancyGrid, poses: np.ndarray, wrong: np.ndarray | None = None) -> None:
        """Show a map, the cells of it that are wrong, shape of the map, bool, and a path, shape (n, >= 2) [m]."""
        ax, (x_min, y_min, x_max, y_max) = self._axes[self._count], self._bounds
        self._count += 1
        shade = np.clip(grid.data, 0, 100)[..., None] / 100.0
        colours = (1.0 - shade) * style.FREE + shade * style.OCCUPIED
        colours[grid.data == UNKNOWN] = style.UNKNOWN
        if wrong is not None:
            colours[ndimage.binary_dilation(wrong, iterations=2)] = WRONG
        left, low, right, high = grid.bounds
        ax.imshow(colours.astype(np.uint8), origin="lower", extent=(left, right, low, high))
        ax.plot(*poses[:, :2].T, color=_hex(PATH), linewidth=0.5, alpha=0.7)
        ax.add_patch(_frame(self._bounds))
        ax.set(xlim=(x_min, x_max), ylim=(y_min, y_max))
        ax.set_title(title, fontsize=10)

    def comment(self, text: str) -> None:
        """Write text in place of the next panel."""
        ax = self._axes[self._count]
        ax.text(0.06, 0.9, text, transform=ax.transAxes, fontsize=10, va="top", color=_hex(style.INK), linespacing=1.5)

    def save(self, path: Path, note: str, legend: dict[str, style.Colour]) -> None:
        """Write the picture, with a scale bar, a line of text and a legend below."""
        x_min, y_min, x_max, _ = self._bounds
        ax, length, gap = self._axes[0], 5.0, 0.06 * (x_max - x_min)
        x, y = x_max - length - gap, y_min + gap
        ax.plot([x, x + length], [y, y], color=_hex(style.INK), linewidth=3, solid_capstyle="butt")
        ax.text(x + 0.5 * length, y + 0.2 * gap, f"{length:g} m", ha="center", va="bottom", fontsize=9)
        marks = [Patch(facecolor=_hex(colour), edgecolor="0.6", label=text) for text, colour in legend.items()]
        line = 0.2 / self._height
        self._figure.text(0.01, line, note, fontsize=9, va="center")
        self._figure.legend(handles=marks, loc="center right", bbox_to_anchor=(0.995, line), ncols=4, fontsize=8)
        self._figure.savefig(path, dpi=DPI)
        with Image.open(path) as image:
            image.convert("RGB").quantize(96, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(
                path, optimize=True
            )


def wrong_cells(grid: OccupancyGrid, walls: OccupancyGrid, far: np.ndarray) -> np.ndarray:
    """Return which cells of a map, world frame, are occupied and lie in cells of `walls` that are `far`, or outside."""
    occupied = np.argwhere(grid.data >= 65)
    cells = walls.cells(grid.centers(occupied))
    is_wrong = ~walls.contains(cells)
    inside = np.flatnonzero(~is_wrong)
    is_wrong[inside] = far[tuple(cells[inside].T)]
    wrong = np.zeros(grid.data.shape, dtype=np.bool_)
    wrong[tuple(occupied[is_wrong].T)] = True
    return wrong


def _extent(poses: np.ndarray, margin: float) -> Bounds:
    """Return the bounds of positions and a margin [m]."""
    low, high = poses[:, :2].min(axis=0) - margin, poses[:, :2].max(axis=0) + margin
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def _around(bounds: Sequence[Bounds]) -> Bounds:
    """Return the bounds of all, and a margin."""
    (x_min, y_min), (x_max, y_max) = np.min(bounds, axis=0)[:2] - MARGIN, np.max(bounds, axis=0)[2:] + MARGIN
    return float(x_min), float(y_min), float(x_max), float(y_max)


def _frame(bounds: Bounds) -> Rectangle:
    """Return the background of a panel: unknown."""
    x_min, y_min, x_max, y_max = bounds
    return Rectangle((x_min, y_min), x_max - x_min, y_max - y_min, facecolor=_hex(style.UNKNOWN), zorder=-1)


def _hex(colour: style.Colour) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)


def main(
    out: Path = Path("docs/images"),
    world: str = "workshop_hall",
    robot: str = "turtlebot3_waffle_pi",
    seed: int = 0,
    minutes: float = 20.0,
) -> None:
    """Draw `slam_maps.png`, and `slam_maps_intel.png` if the Intel log lies in `$LIDARNAUT_DATA/intel`.

    Args:
        out: folder of the pictures.
        world: library world, or path of a world file.
        robot: library robot, or path of a robot file.
        seed: of goals, noise and SLAMs.
        minutes: length of the drive [min].
    """
    out.mkdir(parents=True, exist_ok=True)
    draw_drive(out / "slam_maps.png", world, robot, seed, minutes)
    if "LIDARNAUT_DATA" not in os.environ:
        print("the Intel log is left out; set LIDARNAUT_DATA")
        return
    data = Path(os.environ["LIDARNAUT_DATA"]) / "intel"
    draw_log(out / "slam_maps_intel.png", data / "scans_2725.npz", data / "intel.relations", seed)


if __name__ == "__main__":
    run_command(main)

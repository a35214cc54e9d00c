"""Pictures of every world and every robot, with scale bars."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle, Wedge

from envs.geometry import Pose2D
from envs.rendering import style
from envs.robots import ROBOT_NAMES, RobotParams, load_robot
from envs.worlds import FAMILIES, WORLD_NAMES, World, load_world, reachable

SIZE, DPI = (4.0, 3.4), 110
"""Width and height of a picture [in]; pixels per inch."""
BAR_LENGTHS = np.array([0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0])
"""Lengths that a scale bar may have [m]."""
SEEDS = (0, 1, 2)
"""Worlds of each procedural family."""


def worlds() -> dict[str, World]:
    """Return the worlds of the library and some of each procedural family, by the names of their pictures."""
    drawn = {f"{family}_{seed}": FAMILIES[family](seed, None) for family in FAMILIES for seed in SEEDS}
    return {name: load_world(name) for name in WORLD_NAMES} | drawn


def robots() -> dict[str, RobotParams]:
    """Return the robots of the library by name."""
    return {name: load_robot(name) for name in ROBOT_NAMES}


def draw_world(world: World) -> Figure:
    """Draw a world: what a point can reach in white, spawns as triangles, movers with their paths, a scale bar."""
    figure, ax = _new_figure(world.bounds)
    cell = max(0.02, max(world.bounds[2] - world.bounds[0], world.bounds[3] - world.bounds[1]) / 400.0)
    grid, mask = reachable(world, resolution=cell)
    x_min, y_min, x_max, y_max = grid.bounds
    colours = np.where(mask[..., None], style.FREE, _SOLID).astype(np.uint8)
    ax.imshow(colours, origin="lower", extent=(x_min, x_max, y_min, y_max), zorder=0)
    ax.add_collection(LineCollection(list(world.segments.reshape(-1, 2, 2)), colors=_INK, linewidths=0.8))
    for circle in world.circles:
        ax.add_patch(Circle(circle[:2], circle[2], color=_INK))
    for mover in world.movers:
        ax.add_patch(Polygon(mover.waypoints, fill=False, edgecolor=_MOVER, linewidth=1.0, linestyle=(0, (3, 2))))
        ax.add_patch(Circle(mover.position(0.0), mover.radius, color=_MOVER))
    for k, spawn in enumerate(world.spawns):
        _draw_spawn(ax, spawn, is_first=k == 0)
    return figure


def draw_robot(robot: RobotParams) -> Figure:
    """Draw a robot from above, forward to the right: body, wheels, casters, lidar with its field of view, footprint."""
    reach = 1.15 * robot.radius
    figure, ax = _new_figure((-reach, -reach, reach, reach))
    body, lidar, drive = robot.body, robot.lidar, robot.drive
    x, y, _ = body.center
    if body.size is None:
        ax.add_patch(Circle((x, y), body.radius or 0.0, facecolor=_BODY, edgecolor=_INK))
    else:
        length, width, _ = body.size
        ax.add_patch(Rectangle((x - length / 2, y - width / 2), length, width, facecolor=_BODY, edgecolor=_INK))
    for side in (-1.0, 1.0):
        corner = (-drive.wheel_radius, side * drive.track / 2 - drive.wheel_width / 2)
        ax.add_patch(Rectangle(corner, 2 * drive.wheel_radius, drive.wheel_width, color=_INK))
    for caster in robot.casters:
        ax.add_patch(Circle((caster.x, caster.y), caster.radius, color=style_colour(style.MUTED)))
    mount, half = lidar.mount, 0.5 * np.degrees(lidar.fov)
    heading = np.degrees(mount.yaw)
    colour = style_colour(style.LIDAR)
    ax.add_patch(Wedge((mount.x, mount.y), 3 * reach, heading - half, heading + half, color=colour, alpha=0.12))
    ax.add_patch(Circle((mount.x, mount.y), 0.12 * robot.radius, color=colour))
    ax.add_patch(Circle((0.0, 0.0), robot.radius, fill=False, edgecolor=_INK, linestyle=(0, (4, 3)), linewidth=1.0))
    ax.annotate("", (0.95 * reach, 0.0), (0.6 * reach, 0.0), arrowprops={"arrowstyle": "->", "color": _SPAWN, "lw": 2})
    return figure


def save_all(out: Path) -> dict[str, Path]:
    """Draw all worlds and robots into a folder; return the pictures by the names of what they show."""
    out.mkdir(parents=True, exist_ok=True)
    figures = {name: draw_world(world) for name, world in worlds().items()}
    figures |= {name: draw_robot(robot) for name, robot in robots().items()}
    paths = {name: out / f"{name}.png" for name in figures}
    for name, figure in figures.items():
        figure.savefig(paths[name], dpi=DPI)
    return paths


def style_colour(colour: style.Colour) -> tuple[float, ...]:
    """Return a colour of the renderer as Matplotlib takes it."""
    return tuple(value / 255.0 for value in colour)


_SOLID, _INK, _BODY = style.SOLID, style_colour(style.INK), style_colour(style.RULE)
_MOVER, _SPAWN = style_colour(style.MOVER), style_colour(style.ESTIMATED)


def _new_figure(bounds: tuple[float, float, float, float]) -> tuple[Figure, Axes]:
    """Return an empty figure that shows some part of the plane [m], with a scale bar below it that covers nothing."""
    margin = 0.01 * max(bounds[2] - bounds[0], bounds[3] - bounds[1])
    x_min, y_min, x_max, y_max = (side + sign * margin for side, sign in zip(bounds, (-1, -1, 1, 1)))
    figure = Figure(figsize=SIZE, facecolor="white")
    below = 0.13
    ax = figure.add_axes((0.02, below + 0.01, 0.96, 0.97 - below))
    ax.set(xlim=(x_min, x_max), ylim=(y_min, y_max), aspect="equal")
    ax.set_axis_off()
    scale = min(0.96 * SIZE[0] / (x_max - x_min), (0.97 - below) * SIZE[1] / (y_max - y_min)) / SIZE[0]
    length = BAR_LENGTHS[np.abs(np.log(BAR_LENGTHS * scale / 0.2)).argmin()]
    left = 0.5 - 0.5 * length * scale
    bar = figure.add_axes((left, 0.03, length * scale, 0.04))
    bar.set(xlim=(0, 1), ylim=(0, 1))
    bar.set_axis_off()
    bar.plot([0, 0, 0, 1, 1, 1], [1, 0, 0.5, 0.5, 0, 1], color=_INK, linewidth=2.2, clip_on=False)
    figure.text(left + length * scale + 0.02, 0.05, f"{length:g} m", color=_INK, va="center", fontsize=16)
    return figure, ax


def _draw_spawn(ax: Axes, spawn: Pose2D, *, is_first: bool) -> None:
    marker = (3, 0, np.degrees(spawn.theta) - 90.0)
    face = _SPAWN if is_first else "none"
    ax.plot(spawn.x, spawn.y, marker=marker, markersize=8, markerfacecolor=face, markeredgecolor=_SPAWN)

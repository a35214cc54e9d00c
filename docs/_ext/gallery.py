"""Generate galleries of worlds and robots: pictures with scale bars, dimensions, and sources of worlds."""

import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle, Wedge

from lidarnaut.benchmarks.arena.plots import hex_color
from lidarnaut.envs.files import read_record
from lidarnaut.envs.rendering import style
from lidarnaut.envs.robots import ROBOT_NAMES, RobotParams, load_robot
from lidarnaut.envs.worlds import BARN_NAMES, FAMILIES, WORLD_NAMES, World, free_area, load_world, reachable
from lidarnaut.envs.worlds.library import LIBRARY
from lidarnaut.envs.worlds.world_file import WorldFile

PAGES = {
    "worlds": """\
# Worlds

White areas are reachable from the spawns; grey areas are solid or unreachable. Triangles are spawns (filled: the
default), squares their goals. People on fixed routes are orange, with their routes. Pass the name as `world=`. The free
area is reachable from the first spawn: for a point, and for the centre of a disc of 0.22 m radius. The library is
followed by three of the 300 worlds of BARN, and by worlds 0, 1 and 2 of each procedural family, whose
environments draw a new world at each reset.

""",
    "robots": """\
# Robots

Robots from above, forward to the right: body, driven wheels (black), casters (grey), lidar with its field of view
(blue), and the circle around body and wheels (dashed). Pass the name as `robot=`. The keys of a robot file:
[Your own robot](../../guides/customize/robot.md). The robots of the four documents:
[documents](../../documents/index.md).

""",
}
GRID = "::::{{grid}} 1 2 3 3\n:gutter: 2\n\n{cards}\n\n::::\n"
CARD = ":::{{grid-item-card}} `{title}`\n![{title}]({name}.png)\n\n{text}\n:::"
SIZE, DPI = (4.0, 3.4), 110
"""Width and height of a picture [in]; pixels per inch."""
BAR_LENGTHS = np.array([0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0])
"""Lengths that a scale bar may have [m]."""
_INK, _BODY, _PERSON = map(hex_color, (style.INK, style.RULE, style.PERSON))
_SPAWN, _GOAL = map(hex_color, (style.ESTIMATED, style.FRONTIER))


def pages(folder: Path) -> dict[str, str]:
    """Write the pictures to a folder, and return the pages by file name."""
    folder.mkdir(exist_ok=True)
    families = {f"{family}_{seed}": FAMILIES[family](seed, None) for family in FAMILIES for seed in range(3)}
    barn = {name.replace(":", "_"): load_world(name) for name in BARN_NAMES[::149]}
    worlds = {name: load_world(name) for name in WORLD_NAMES} | barn | families
    robots = {name: load_robot(name) for name in ROBOT_NAMES}
    figures = {name: draw_world(world) for name, world in worlds.items()}
    figures |= {name: draw_robot(robot) for name, robot in robots.items()}
    for name, figure in figures.items():
        figure.savefig(folder / f"{name}.png", dpi=DPI)
    cards = {
        "worlds": [CARD.format(title=w.name, name=name, text=_of_world(w)) for name, w in worlds.items()],
        "robots": [CARD.format(title=name, name=name, text=_of_robot(r)) for name, r in robots.items()],
    }
    found = {f"{page}.md": text for page, text in PAGES.items()}
    for page, texts in cards.items():
        found[f"{page}.md"] += GRID.format(cards="\n\n".join(texts))
    sources = [*map(_source, WORLD_NAMES), *(f"- `{w.name}`: {w.source}. {w.notes}" for w in barn.values())]
    found["worlds.md"] += "\n## Sources\n\n" + "\n".join(sources) + "\n"
    return found


def draw_world(world: World) -> Figure:
    """Draw a world: reachable area in white, spawns as triangles, goals as squares, people, a scale bar."""
    figure, ax = _new_figure(world.bounds)
    cell = max(0.02, max(world.bounds[2] - world.bounds[0], world.bounds[3] - world.bounds[1]) / 400.0)
    grid, mask = reachable(world, resolution=cell)
    x_min, y_min, x_max, y_max = grid.bounds
    colours = np.where(mask[..., None], style.FREE, style.SOLID).astype(np.uint8)
    ax.imshow(colours, origin="lower", extent=(x_min, x_max, y_min, y_max), zorder=0)
    ax.add_collection(LineCollection(list(world.segments.reshape(-1, 2, 2)), colors=_INK, linewidths=0.8))
    for circle in world.circles:
        ax.add_patch(Circle(circle[:2], circle[2], color=_INK))
    for person in world.people:
        ax.add_patch(Polygon(person.waypoints, fill=False, edgecolor=_PERSON, linewidth=1.0, linestyle=(0, (3, 2))))
        ax.add_patch(Circle(person.waypoints[0], person.radius, color=_PERSON))
    for k, spawn in enumerate(world.spawns):
        marker = (3, 0, np.degrees(spawn.theta) - 90.0)
        ax.plot(spawn.x, spawn.y, marker=marker, markersize=8, color=_SPAWN, fillstyle="none" if k else "full")
    for k, goal in enumerate(world.goals):
        ax.plot(goal.x, goal.y, marker="s", markersize=6, color=_GOAL, fillstyle="none" if k else "full")
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
        ax.add_patch(Circle((caster.x, caster.y), caster.radius, color=hex_color(style.MUTED)))
    mount, half, heading = lidar.mount, 0.5 * np.degrees(lidar.fov), np.degrees(lidar.mount.yaw)
    colour = hex_color(style.LIDAR)
    ax.add_patch(Wedge((mount.x, mount.y), 3 * reach, heading - half, heading + half, color=colour, alpha=0.12))
    ax.add_patch(Circle((mount.x, mount.y), 0.12 * robot.radius, color=colour))
    ax.add_patch(Circle((0.0, 0.0), robot.radius, fill=False, edgecolor=_INK, linestyle=(0, (4, 3)), linewidth=1.0))
    ax.annotate("", (0.95 * reach, 0.0), (0.6 * reach, 0.0), arrowprops={"arrowstyle": "->", "color": _SPAWN, "lw": 2})
    return figure


def _new_figure(bounds: tuple[float, float, float, float]) -> tuple[Figure, Axes]:
    """Return an empty figure for bounds (x_min, y_min, x_max, y_max) [m], with a scale bar below the axes."""
    margin, below = 0.01 * max(bounds[2] - bounds[0], bounds[3] - bounds[1]), 0.13
    x_min, y_min, x_max, y_max = (side + sign * margin for side, sign in zip(bounds, (-1, -1, 1, 1)))
    figure = Figure(figsize=SIZE, facecolor="white")
    ax = figure.add_axes((0.02, below + 0.01, 0.96, 0.97 - below))
    ax.set(xlim=(x_min, x_max), ylim=(y_min, y_max), aspect="equal")
    ax.set_axis_off()
    scale = min(0.96 * SIZE[0] / (x_max - x_min), (0.97 - below) * SIZE[1] / (y_max - y_min)) / SIZE[0]
    length = BAR_LENGTHS[np.abs(np.log(BAR_LENGTHS * scale / 0.2)).argmin()]
    left = 0.5 - 0.5 * length * scale
    bar = figure.add_axes((left, 0.03, length * scale, 0.04), xlim=(0, 1), ylim=(0, 1))
    bar.set_axis_off()
    bar.plot([0, 0, 0, 1, 1, 1], [1, 0, 0.5, 0.5, 0, 1], color=_INK, linewidth=2.2, clip_on=False)
    figure.text(left + length * scale + 0.02, 0.05, f"{length:g} m", color=_INK, va="center", fontsize=16)
    return figure, ax


def _of_world(world: World) -> str:
    """Return size and free areas, and the licence of a library world."""
    x_min, y_min, x_max, y_max = world.bounds
    areas = " and ".join(f"{free_area(world, radius=radius):.1f} m²" for radius in (0.0, 0.22))
    licence = "" if world.source == "generated" else f"; licence: {world.licence}"
    return f"{x_max - x_min:.1f} m x {y_max - y_min:.1f} m; free area {areas}{licence}"


def _source(name: str) -> str:
    """Return a list item with source, notes and closed openings of a library world."""
    file = read_record(LIBRARY[name], WorldFile)
    closed = sum(math.dist(row[:2], row[2:]) for row in file.closures)
    added = f" Added to close the world: {closed:.1f} m of wall." if file.closures else ""
    return f"- `{name}`: {file.source}. {file.notes or ''}{added}".rstrip()


def _of_robot(robot: RobotParams) -> str:
    lidar = robot.lidar
    return (
        f"radius {robot.radius:g} m, {robot.max_v:g} m/s, {robot.max_w:g} rad/s; "
        f"lidar: {lidar.num_beams} beams over {math.degrees(lidar.fov):.0f}°, {lidar.range_max:g} m"
    )

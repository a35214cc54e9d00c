"""Galleries of worlds and robots, drawn by `gallery`."""

import math
from pathlib import Path

import gallery

from envs.robots import RobotParams
from envs.worlds import World

INDEX = """\
# Galleries

```{toctree}
worlds
robots
```
"""
WORLDS = """\
# Worlds

White is what can be reached from the spawns (triangles; the filled one is the usual one), grey is solid or not reached,
movers are orange with the lines that they walk along. Pass the name as `world=`. [Worlds](../worlds.md) tells sources,
licences and areas. The last rows show worlds 0, 1 and 2 of each procedural family, of which environments draw a new one
at each reset.

"""
ROBOTS = """\
# Robots

From above, forward to the right: body, driven wheels (black), casters (grey), lidar with its field of view (blue), and
the circle that holds body and wheels (dashed). Pass the name as `robot=`.

"""
GRID = "::::{{grid}} 1 2 3 3\n:gutter: 2\n\n{cards}\n\n::::\n"
CARD = ":::{{grid-item-card}} `{title}`\n![{title}]({name}.png)\n\n{text}\n:::"


def pages(folder: Path) -> dict[str, str]:
    """Draw the pictures into a folder, and return the pages that show them, by file name."""
    if not folder.exists() or _is_old(folder):
        gallery.save_all(folder)
    worlds = [CARD.format(title=w.name, name=name, text=_of_world(w)) for name, w in gallery.worlds().items()]
    robots = [CARD.format(title=name, name=name, text=_of_robot(r)) for name, r in gallery.robots().items()]
    return {
        "index.md": INDEX,
        "worlds.md": WORLDS + GRID.format(cards="\n\n".join(worlds)),
        "robots.md": ROBOTS + GRID.format(cards="\n\n".join(robots)),
    }


def _is_old(folder: Path) -> bool:
    """Tell whether a world or robot has changed, or how it is drawn, since the pictures were."""
    root = Path(gallery.__file__).parents[2]
    sources = [*root.glob("envs/worlds/**/*"), *root.glob("envs/robots/**/*"), Path(gallery.__file__)]
    newest = max(path.stat().st_mtime for path in sources if path.suffix in (".py", ".yaml"))
    return min((path.stat().st_mtime for path in folder.glob("*.png")), default=0.0) < newest


def _of_world(world: World) -> str:
    x_min, y_min, x_max, y_max = world.bounds
    return f"{x_max - x_min:.1f} m x {y_max - y_min:.1f} m"


def _of_robot(robot: RobotParams) -> str:
    lidar = robot.lidar
    return (
        f"radius {robot.radius:g} m, {robot.max_v:g} m/s, {robot.max_w:g} rad/s; "
        f"lidar: {lidar.num_beams} beams over {math.degrees(lidar.fov):.0f}°, {lidar.range_max:g} m"
    )

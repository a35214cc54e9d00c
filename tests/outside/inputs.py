"""Files that other tools write from valid data, given to the readers of the package."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lidarnaut.envs.logs import load_log
from lidarnaut.envs.logs.relations import load_relations
from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.worlds import load_map

from .checks import close, same_log
from .environments import run
from .files import ROBOT, Files


class Input(NamedTuple):
    """A file of another tool, with the function that reads it and returns why the result is wrong (empty if right)."""

    door: str
    name: str
    read: Callable[[], str]
    is_refused: bool = False
    """Whether the package has no reader of this kind of file, and must refuse it in one line."""


def bags(files: Files) -> Iterator[Input]:
    for name, path in files.bags_of_others.items():
        yield Input("bag", name, lambda path=path: same_log(path, files))


def maps(files: Files) -> Iterator[Input]:
    grid = files.grid
    classes = np.where(grid.free, "free", np.where(grid.occupied, "occupied", "unknown"))
    given = {"classes": classes[::-1].tolist(), "resolution": grid.resolution, "origin": grid.origin}
    wanted = np.where(grid.free, 0, np.where(grid.occupied, 100, -1))

    def read(path: str) -> str:
        found = load_map(path)
        gap = close(
            [found.resolution, *found.origin], [grid.resolution, *grid.origin], 1e-9, "resolution or origin [m]"
        )
        return gap or close(found.data, wanted, 0, "cells [%]")

    for name, path in run("maps", "maps.py", "write", files.folder / "maps", given=given).items():
        yield Input("map", name, lambda path=path: read(path))


def robots(files: Files) -> Iterator[Input]:
    def read(path: str) -> str:
        return "" if load_robot(path) == load_robot(ROBOT) else "another robot"

    for name, path in run("maps", "maps.py", "write_yaml", ROBOT, files.folder / "yaml").items():
        yield Input("robot", name, lambda path=path: read(path))
    urdf = str(files.urdf)
    for name, path in {
        "URDF of this package": urdf,
        **run("robots", "robots.py", "write", urdf, files.folder / "urdf"),
    }.items():
        yield Input("robot", name, lambda path=path: refused(load_robot, path), is_refused=True)


def others(files: Files) -> Iterator[Input]:
    for name, path in run("graphs", "graphs.py", "write", files.folder / "graphs").items():
        for door, reader in (("log", load_log), ("relations", load_relations)):
            yield Input(door, name, lambda reader=reader, path=path: refused(reader, path), is_refused=True)


def refused(reader: Callable[[Any], Any], path: str) -> str:
    """Return why a reader does not refuse a file in one line that names it; empty if it does."""
    try:
        reader(Path(path))
    except ValueError as error:
        text = str(error)
        return "" if text.startswith(path) and "\n" not in text else f"refused by {text!r}"
    return "is read"


DOORS = {"bags": bags, "maps": maps, "robots": robots, "graphs, trajectories": others}

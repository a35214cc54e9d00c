"""Files that other tools write from valid data, given to the readers of the package."""

import re
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from lidarnaut.envs.logs import load_log
from lidarnaut.envs.logs.relations import load_relations
from lidarnaut.envs.robots import load_robot
from lidarnaut.envs.worlds import load_map

from .cells import Cell, close
from .environments import ROOT, RefusedError, SkippedError, run
from .files import Files

CREATE = ROOT / "envs" / "robots" / "library" / "create3.yaml"


def written_by_others(files: Files, only: str) -> Iterator[Cell]:
    for door in (bags, maps, robots, graphs):
        if only in f"inputs {door.__name__}":
            try:
                yield from door(files)
            except (SkippedError, RefusedError) as error:
                yield Cell(door.__name__, "all", partial(fail, error))


def fail(error: Exception, files: Files) -> None:
    raise error


def bags(files: Files) -> Iterator[Cell]:
    for name, path in files.bags_of_others.items():
        yield Cell("bag", name, partial(same_log, path), "read")


def same_log(path: str, files: Files) -> None:
    found, wanted = load_log(path), files.bag.log
    ranges = [np.nan_to_num(log.ranges, nan=-1.0, posinf=-2.0) for log in (found, wanted)]
    angles = [log.lidar.angles + log.lidar.mount.yaw for log in (found, wanted)]
    assert not found.notes, "; ".join(found.notes)
    close(found.times, wanted.times, 1e-6, "times [s]")
    close(found.odometry, wanted.odometry, 1e-9, "odometry [m]")
    close(*ranges, 0, "ranges [m]")
    close(*angles, 1e-6, "angles [rad]")
    close(found.lidar.range_max, wanted.lidar.range_max, 1e-8, "range_max [m]")


def maps(files: Files) -> Iterator[Cell]:
    grid = files.grid
    classes = np.where(grid.free, "free", np.where(grid.occupied, "occupied", "unknown"))
    given = {"classes": classes[::-1].tolist(), "resolution": grid.resolution, "origin": grid.origin}
    for name, path in run("maps", "maps", "write", files.folder_of("maps"), **given).items():
        yield Cell("map", name, partial(same_map, path), "read")


def same_map(path: str, files: Files) -> None:
    found, grid = load_map(path), files.grid
    places = [[one.resolution, *one.origin] for one in (found, grid)]
    cells = np.where(grid.free, 0, np.where(grid.occupied, 100, -1))
    close(*places, 1e-9, "resolution or origin [m]")
    close(found.data, cells, 0, "cells [%]")


def robots(files: Files) -> Iterator[Cell]:
    for name, path in run("maps", "maps", "write_yaml", CREATE, files.folder_of("yaml")).items():
        yield Cell("robot", name, partial(same_robot, path), "read")
    written = run("robots", "robots", "write", files.urdf, files.folder_of("urdf"))
    for name, path in {"URDF of this package": str(files.urdf), **written}.items():
        yield Cell("robot", name, partial(refuses, load_robot, path), "refused in one line")


def same_robot(path: str, files: Files) -> None:
    assert load_robot(path) == load_robot("create3"), "another robot"


def graphs(files: Files) -> Iterator[Cell]:
    given = files.graph.path, files.trajectory.path
    for name, path in run("graphs", "graphs", "write", *given, files.folder_of("graphs")).items():
        for door, reader in (("log", load_log), ("relations", load_relations)):
            yield Cell(door, name, partial(refuses, reader, path), "refused in one line")


def refuses(reader: Callable[[Any], Any], path: str, files: Files) -> None:
    """Raise an AssertionError unless a reader refuses a file in one line that names it."""
    try:
        reader(Path(path))
        answer = "is read"
    except ValueError as error:
        answer = str(error)
    assert re.fullmatch(f"{re.escape(path)}.*", answer), answer

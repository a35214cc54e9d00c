"""Finding a world by what users call it."""

import difflib
from collections.abc import Callable
from functools import lru_cache, partial
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from .map_files import load_map, world_from_map
from .procedural import FAMILIES
from .raster import check_world
from .world import World
from .world_file import load_yaml, read_world_file

LIBRARY = Path(__file__).parent / "library"
"""Folder of the world files that come with the project."""
WORLD_NAMES = tuple(sorted(path.stem for path in LIBRARY.glob("*.yaml")))
"""Names of the worlds in the library."""

Split = Literal["train", "test"]
WorldSampler = Callable[[np.random.Generator], World]


def load_world(name_or_path: str | Path) -> World:
    """Return a world of the library, or one from a world file or a `map_server` YAML.

    Loaded once: the same name, or path to an unchanged file, gives the same object.

    Raises:
        ValueError: for a name that the library does not have or a file that is not a valid world.
        FileNotFoundError: if there is no such file.
    """
    if name_or_path in WORLD_NAMES:
        path = LIBRARY / f"{name_or_path}.yaml"
    else:
        path = Path(name_or_path)
        if path.suffix not in (".yaml", ".yml"):
            raise ValueError(_unknown(str(name_or_path)))
        if not path.is_file():
            raise FileNotFoundError(f"there is no world file {path}")
    return _load(path.resolve(), path.stat().st_mtime_ns)


@lru_cache(maxsize=64)
def _load(path: Path, modified: int) -> World:
    """Read a world file or a map; `modified` only makes a changed file another key of the cache."""
    try:
        is_map = "image" in load_yaml(path)
    except ValueError as error:
        raise ValueError(f"world file {path}: {error}") from error
    return world_from_map(load_map(path), path.stem, source=str(path)) if is_map else read_world_file(path)


def world_sampler(
    world: str | Path | World, *, split: Split = "train", size: tuple[float, float] | None = None
) -> WorldSampler:
    """Return a function that gives the world of the next episode.

    Args:
        world: name of a library world or of a procedural family, path of a world file or of a `map_server` YAML, or
            a world. All but families give the same object each time.
        split: which worlds of a family to draw: `train` has the even world seeds, `test` the odd ones.
        size: outer size (x, y) of a family's worlds [m]; `None` leaves it to the family.

    Raises:
        ValueError: for an unknown world, split or size, or a world that leaks; names the allowed values.
        FileNotFoundError: if there is no such file.
    """
    if split not in get_args(Split):
        raise ValueError(f"split must be one of {get_args(Split)}, got {split!r}")
    if isinstance(world, str) and world in FAMILIES:
        FAMILIES[world](0, size)  # a size that the family refuses should fail here, not at the first reset
        return partial(_draw, world, split == "test", size)
    if size is not None:
        raise ValueError(f"size is for procedural families ({', '.join(FAMILIES)}); {world!r} has its own")
    return partial(_same, check_world(world) if isinstance(world, World) else load_world(world))


# Functions of the module and not closures, so that environments can be pickled.
def _draw(family: str, is_test: bool, size: tuple[float, float] | None, rng: np.random.Generator) -> World:
    return FAMILIES[family](2 * int(rng.integers(2**31)) + is_test, size)


def _same(world: World, rng: np.random.Generator) -> World:
    return world


def _unknown(name: str) -> str:
    close = difflib.get_close_matches(name, [*WORLD_NAMES, *FAMILIES], n=1)
    hint = f" (did you mean {close[0]!r}?)" if close else ""
    return (
        f"unknown world {name!r}{hint}; allowed are the library's {', '.join(WORLD_NAMES)}, the procedural families "
        f"{', '.join(FAMILIES)}, and paths of world files or map_server files that end in .yaml"
    )

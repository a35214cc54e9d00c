import contextlib
import os
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from numbers import Integral
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from lidarnaut.envs.files import SHORT, parse_record, read_mapping, resolve

from .barn import barn_world
from .map_files import check_no_image, load_map
from .map_worlds import world_from_map
from .procedural import FAMILIES
from .raster import check_world
from .world import World
from .world_file import WorldFile, build_world

LIBRARY = {path.stem: path for path in sorted((Path(__file__).parent / "library").glob("*.yaml"))}
"""Built-in world files, by world name."""
WORLD_NAMES = tuple(LIBRARY)

Split = Literal["train", "validation", "test"]
FIRST_SEED = {"train": 0, "validation": 2**32, "test": 1}
"""First seed of a family's worlds by split; further seeds follow in steps of 2, up to 2**32 for `train` and `test`."""
WorldSampler = Callable[[np.random.Generator], World]


def load_world(world: str | Path | World) -> World:
    """Load a world by name, from a file or as `module:attribute`; return a given `World` after a check.

    Names are those of the library and `barn:0` to `barn:299`. Files are world files or `map_server` YAML files. Results
    are cached until the file changes.

    Raises:
        ValueError: the name is unknown or the world is invalid.
        FileNotFoundError: the file does not exist.
        TypeError: `world` has another type.
    """
    found = _resolve(world, LIBRARY)
    if isinstance(found, World):
        return check_world(found)
    if not isinstance(found, Path):
        if isinstance(world, str):
            wanted = "a World (functions are for environments)"
            raise ValueError(f"world {world!r} must name {wanted}, got {SHORT.repr(found)}")
        raise TypeError(f"world must be a name, a path, module:attribute or a World, got {type(found).__name__}")
    if not found.is_file():
        raise FileNotFoundError(f"there is no world file {found}")
    image = _image_of(path := Path(os.path.abspath(found)), _version(path))
    return _read(path, _version(path), image and _version(image))


def _resolve(world: Any, table: Mapping[str, Any]) -> Any:
    if isinstance(world, str) and world.startswith("barn:"):
        return barn_world(world)
    if isinstance(world, str) and world not in table:
        check_no_image(Path(world))
    return resolve(world, table, "world", files=True)


def _version(path: Path) -> tuple[int, ...] | None:
    with contextlib.suppress(OSError, ValueError):
        found = path.stat()
        return found.st_mtime_ns, found.st_ctime_ns, found.st_size, found.st_ino
    return None


@lru_cache(maxsize=64)
def _image_of(path: Path, version: tuple[int, ...] | None) -> Path | None:
    image = read_mapping(path).get("image")
    return path.parent / image if isinstance(image, str) else None


@lru_cache(maxsize=64)
def _read(path: Path, version: tuple[int, ...] | None, image: tuple[int, ...] | None) -> World:
    content = read_mapping(path)
    build: Callable[[], World]
    if "image" in content:
        build = partial(world_from_map, load_map(path), path.stem, source=str(path))
    else:
        build = partial(build_world, path.stem, parse_record(content, str(path), WorldFile))
    try:
        return build()
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def world_sampler(
    world: str | Path | World | WorldSampler | Sequence[Any],
    *,
    split: Split = "train",
    size: tuple[float, float] | None = None,
    radius: float = 0.0,
    difficulty: float | None = None,
    num_worlds: int | None = None,
) -> WorldSampler:
    """Return a function that samples a world for each episode.

    Args:
        world: library world, BARN world (`barn:12`), procedural family, path of a world file or `map_server` YAML,
            `World`, function from a random generator to a `World`, `module:attribute`, or a list of these.
        split: worlds of a family: `train` has even seeds, `test` odd seeds, both below 2**32; `validation` has even
            seeds from 2**32 on.
        size: outer size (x, y) of a family's worlds [m]; `None` draws from the family's range.
        radius: radius of the robot that must fit into a family's worlds [m].
        difficulty: difficulty of `clutter`, from 0 to 1; `None` draws a value for each world.
        num_worlds: number of different worlds of a family; `None` is unlimited.

    Raises:
        ValueError: an argument or a world is invalid.
        FileNotFoundError: the file does not exist.
        TypeError: `world` has another type.
    """
    if split not in get_args(Split):
        raise ValueError(f"split must be one of {get_args(Split)}, got {split!r}")
    if num_worlds is not None and not (isinstance(num_worlds, Integral) and num_worlds > 0):
        raise ValueError(f"num_worlds must be a positive whole number or None, got {num_worlds!r}")
    if isinstance(world, list | tuple):
        if not world:
            raise ValueError("world is an empty list; name at least one")
        sampler = partial(world_sampler, split=split, radius=radius, num_worlds=num_worlds)
        sizes = [size if isinstance(one, str) and one in FAMILIES else None for one in world]
        grades = [difficulty if one == "clutter" else None for one in world]
        each = [sampler(one, size=own, difficulty=grade) for one, own, grade in zip(world, sizes, grades)]
        return partial(_draw_one_of, each)
    if isinstance(world, str) and world in FAMILIES:
        settings: dict[str, Any] = {"size": size, "radius": radius, "difficulty": difficulty}
        FAMILIES[world](0, **settings)  # fail before the first reset
        if num_worlds is None:
            return partial(_draw, partial(FAMILIES[world], **settings), FIRST_SEED[split], 2**31)
        settings["size"] = None if size is None else tuple(size)
        return partial(_draw, partial(_generate_once, world, **settings), FIRST_SEED[split], num_worlds)
    found: Any = _resolve(world, {**LIBRARY, **FAMILIES})
    if size is not None:
        families = ", ".join(FAMILIES)
        raise ValueError(f"size applies to procedural families only ({families}); {world!r} has a fixed size")
    if difficulty is not None:
        raise ValueError(f"difficulty applies to the family 'clutter' only, not to {world!r}")
    if callable(found):
        return partial(_sample, found)
    return partial(_same, load_world(world if isinstance(world, str) else found))


# Not closures, because environments are pickled.
def _draw(generate: Callable[[int], World], first: int, count: int, rng: np.random.Generator) -> World:
    return generate(2 * int(rng.integers(count)) + first)


def _draw_one_of(samplers: Sequence[WorldSampler], rng: np.random.Generator) -> World:
    return samplers[int(rng.integers(len(samplers)))](rng)


@lru_cache(maxsize=1024)
def _generate_once(family: str, seed: int, **settings: Any) -> World:
    return FAMILIES[family](seed, **settings)


def _sample(sample: WorldSampler, rng: np.random.Generator) -> World:
    world = sample(rng)
    if not isinstance(world, World):
        raise TypeError(f"world: {sample!r} must return a World, got {type(world).__name__}")
    return world


def _same(world: World, rng: np.random.Generator) -> World:
    return world


def has_no_effects(sample: WorldSampler) -> bool:
    """Return True if a world sampler runs no user code."""
    kind = getattr(sample, "func", None)
    return kind in (_draw, _same) or (kind is _draw_one_of and all(map(has_no_effects, sample.args[0])))  # type: ignore[attr-defined]

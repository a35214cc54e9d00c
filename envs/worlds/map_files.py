"""Maps on disk in the format of ROS's map_server: an image and a YAML file that explains it."""

import io
import os
import warnings
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import yaml
from PIL import Image
from pydantic import BaseModel, Field
from scipy import ndimage

from lidarnaut.envs.files import read_record, write_file
from lidarnaut.envs.geometry import FREE, OCCUPIED, UNKNOWN, OccupancyGrid, Pose2D
from lidarnaut.envs.geometry.distance_transform import deepest_cell
from lidarnaut.envs.progress import Progress

from .raster import MAX_CELLS, check_world, outline
from .world import World
from .world_file import Number, Size

OCCUPIED_THRESH = 0.65
"""Occupancy above which a saved cell reads as occupied."""
FREE_THRESH = 0.196
"""Occupancy below which a saved cell reads as free; the saver's grey for unknown, 205, reads as 0.19608."""
IMAGE_FORMATS = ("PNG", "PPM", "BMP", "JPEG", "GIF", "TIFF")
"""Kinds of images that maps are read from; PPM stands for PGM and PBM too."""
_DELAY = 2.0
"""Time after which there is a progress bar [s]."""


class MapFile(BaseModel):
    """The YAML part of a map. Keys that map_server does not know are ignored, as map_server does."""

    image: str
    resolution: Size
    origin: Annotated[list[Number], Field(min_length=3, max_length=3)]
    negate: bool
    occupied_thresh: float = Field(ge=0, le=1)
    free_thresh: float = Field(ge=0, le=1)
    mode: Literal["trinary", "scale", "raw"] = "trinary"


def map_paths(path: Path) -> tuple[Path, Path]:
    """Return the image and the YAML file that `save_map` writes; ValueError if the path ends otherwise."""
    if path.suffix not in ("", ".yaml", ".yml", ".pgm", ".png"):
        raise ValueError(f"a map is saved as .yaml, .pgm or .png, got {path}")
    image_path = path if path.suffix in (".pgm", ".png") else path.with_suffix(".pgm")
    return image_path, path if path.suffix in (".yaml", ".yml") else path.with_suffix(".yaml")


def save_map(grid: OccupancyGrid, path: str | Path) -> Path:
    """Save a grid as map_saver does: 254 free, 0 occupied, 205 unknown or undecided; a full disk changes nothing.

    `path`, which is returned: `NAME.yaml` or `NAME` (image in `NAME.pgm`), `NAME.pgm` or `NAME.png` (YAML in
    `NAME.yaml`); ValueError for another suffix, OSError if writing fails.
    """
    image_path, yaml_path = map_paths(Path(path))
    pixels = np.full(grid.data.shape, 205, dtype=np.uint8)
    pixels[(grid.data >= 0) & (grid.data < 100 * FREE_THRESH)] = 254
    pixels[grid.data >= 100 * OCCUPIED_THRESH] = 0
    image = io.BytesIO()
    content = {
        "image": image_path.name,
        "resolution": float(grid.resolution),
        "origin": [*map(float, grid.origin), 0.0],
        "negate": 0,
        "occupied_thresh": OCCUPIED_THRESH,
        "free_thresh": FREE_THRESH,
        "mode": "trinary",
    }
    file_format = "PNG" if image_path.suffix == ".png" else "PPM"  # Pillow writes grey images as PGM P5 under this name
    Image.fromarray(np.ascontiguousarray(pixels[::-1])).save(image, format=file_format)
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None)
    for target, written in ((image_path, image.getvalue()), (yaml_path, text)):
        try:
            write_file(target, written)
        except OSError as error:
            raise OSError(error.errno, f"cannot save {target}: {error.strerror}") from error
    return yaml_path


def load_map(path: str | Path) -> OccupancyGrid:
    """Read a map from its YAML file, with map_server's modes `trinary`, `scale` and `raw`.

    Colours are averaged, transparent pixels are unknown in `scale`. In `raw`, pixel values up to 100 are percentages
    and all others unknown.

    Raises:
        ValueError: if the YAML or the image is damaged, or the map is rotated; names the file and the key.
        FileNotFoundError: if one of the files is missing.
    """
    path = Path(path)
    file = read_record(path, MapFile)
    if file.origin[2] != 0:
        raise ValueError(f"{path}: origin has a yaw of {file.origin[2]} rad; only 0 is allowed, rotate the image")
    if not file.free_thresh < file.occupied_thresh:
        raise ValueError(f"{path}: free_thresh {file.free_thresh} must lie below {file.occupied_thresh}")
    data = _read_image(path, file)
    return OccupancyGrid(np.ascontiguousarray(data[::-1]), file.resolution, (file.origin[0], file.origin[1]))


def _read_image(source: Path, file: MapFile) -> np.ndarray:
    """Return the occupancy of the pixels of the image that a YAML file names, its shape, int8 [percent], -1 unknown."""
    path = source.parent / file.image
    if not os.path.isfile(path):  # False for what is no path at all
        raise FileNotFoundError(f"{source}: there is no map image {str(path)[:300]}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # there is a limit of ours
            with Image.open(path, formats=IMAGE_FORMATS) as image:
                if image.width * image.height > MAX_CELLS:
                    raise ValueError(f"{image.width} x {image.height} pixels; at most {MAX_CELLS:,} are allowed")
                is_deep = image.mode.startswith("I")
                alpha = np.asarray(image.convert("RGBA"))[..., 3] if image.has_transparency_data else None
                plain = image.mode in ("L", "I", "I;16", "I;16B")
                array = np.asarray(image if plain else image.convert("RGB"))
    except PermissionError:
        raise
    except Exception as error:  # Pillow raises many kinds for damaged files
        said = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(f"{source}: map image {path} cannot be read: {said}") from error
    if array.ndim == 3:
        data = _interpret(np.arange(766) / 3, file)[array.sum(axis=2, dtype=np.uint16)]
    elif is_deep:
        data = _interpret(np.arange(65536) / 257, file)[array.clip(0, 65535)]
    else:
        data = _interpret(np.arange(256.0), file)[array]
    if alpha is not None and file.mode == "scale":
        data[alpha < 255] = UNKNOWN
    return data


def _interpret(grey: np.ndarray, file: MapFile) -> np.ndarray:
    """Return the occupancy of grey values from 0 to 255: int8 [percent], -1 for unknown."""
    if file.mode == "raw":
        return np.where(grey <= 100, np.rint(grey), UNKNOWN).astype(np.int8)
    occupancy = grey / 255 if file.negate else (255 - grey) / 255
    data = np.full(grey.shape, UNKNOWN, dtype=np.int8)
    if file.mode == "scale":
        share = (occupancy - file.free_thresh) / (file.occupied_thresh - file.free_thresh)
        data[:] = np.rint(100 * np.clip(share, 0, 1))
    data[occupancy > file.occupied_thresh] = OCCUPIED
    data[occupancy < file.free_thresh] = FREE
    return data


def world_from_map(grid: OccupancyGrid, name: str, spawn: Pose2D | None = None, source: str = "") -> World:
    """Turn a map into a world: the outline of one connected area of free cells.

    Everything else is solid: occupied cells and unknown ones, so that the world is closed whatever the map
    leaves open. Cells from 20 to 64 percent count as unseen, as they do where maps are saved. A progress bar shows up
    if it takes longer than two seconds. The spawn is by default in the largest free area, as far from anything solid as
    it gets.

    Raises:
        ValueError: if the map has no free cell, or the spawn does not lie on one.
    """
    with Progress(total=4, desc=f"world of map {name}", unit="step", delay=_DELAY, leave=False) as bar:
        area = _free_area(grid, name, spawn)
        bar.update()
        if spawn is None:
            x, y = grid.centers(np.array(deepest_cell(area)) - 1)
            spawn = Pose2D(float(x), float(y), 0.0)
        bar.update()
        height, width = grid.data.shape
        xs = grid.origin[0] + grid.resolution * np.arange(width + 1)
        ys = grid.origin[1] + grid.resolution * np.arange(height + 1)
        segments = outline(~area[1:-1, 1:-1], xs, ys)
        bar.update()
        sides = segments[:, ::2], segments[:, 1::2]
        world = World(
            name=name,
            segments=segments,
            circles=np.empty((0, 3)),
            spawns=(spawn,),
            bounds=(*(float(side.min()) for side in sides), *(float(side.max()) for side in sides)),  # type: ignore[arg-type]
            source=source,
            notes="Outline of the free cells of a map; unknown cells count as solid.",
        )
        return check_world(world)


def _free_area(grid: OccupancyGrid, name: str, spawn: Pose2D | None) -> np.ndarray:
    """Return the free area of a spawn, by default the largest one, with a margin of a cell; see `world_from_map`."""
    free = (grid.data >= 0) & (grid.data < 100 * FREE_THRESH)
    labels, count = ndimage.label(free)
    if count == 0:
        raise ValueError(f"map {name!r} has no free cell")
    if spawn is None:
        label = 1 + int(np.argmax(np.bincount(labels.ravel())[1:]))
    else:
        cell = grid.cells(np.array([spawn.x, spawn.y]))
        label = labels[tuple(cell)] if grid.contains(cell) else 0
        if label == 0:
            raise ValueError(f"spawn {tuple(spawn)} does not lie on a free cell of map {name!r}")
    return np.pad(labels == label, 1)

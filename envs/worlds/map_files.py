"""Maps in the format of ROS map_server: an image and a YAML file."""

import io
import logging
import math
import os
import warnings
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import yaml
from PIL import Image
from pydantic import BaseModel, Field

from lidarnaut.envs.files import check_file, printable, read_record, write_file
from lidarnaut.envs.geometry import FREE, OCCUPIED, UNKNOWN, OccupancyGrid

from .raster import MAX_CELLS
from .world_file import Number, Size

OCCUPIED_THRESH = 0.65
"""Minimum occupancy of occupied pixels in saved maps, from 0 to 1."""
FREE_THRESH = 0.196
"""Maximum occupancy of free pixels in saved maps, from 0 to 1; just below the 0.19608 of unknown pixels (grey 205)."""
SAVED_UNKNOWN = 205
"""Grey value of unknown cells in images from map_saver."""
SAVED_VALUES = (0, SAVED_UNKNOWN, 254, 255)
"""Grey values in images from map_saver, and pure white."""
SAVED_TOLERANCE, SAVED_SHARE = 0.5, 0.98
"""An image counts as written by map_saver if at least the fraction `SAVED_SHARE` of its pixels have one of the grey
values `SAVED_VALUES`, within `SAVED_TOLERANCE`."""
MAX_YAW = 1e-6
"""Maximum yaw of a map that counts as not rotated [rad]."""
IMAGE_SUFFIXES = (".pgm", ".png", ".bmp", ".jpg", ".jpeg", ".gif", ".tif", ".tiff", ".ppm", ".pbm")
MAX_IMAGE_BYTES = 4 * MAX_CELLS
"""Maximum size of a map image file [bytes]."""
IMAGE_FORMATS = ("PNG", "PPM", "BMP", "JPEG", "GIF", "TIFF")
"""Pillow's names of the image formats for maps; PPM includes PGM and PBM."""


class MapFile(BaseModel):
    """Content of a map's YAML file; unknown keys are ignored, as in map_server."""

    image: str
    resolution: Size
    origin: Annotated[list[Number], Field(min_length=3, max_length=3)]
    negate: bool
    occupied_thresh: float = Field(ge=0, le=1)
    free_thresh: float = Field(ge=0, le=1)
    mode: Literal["trinary", "scale", "raw"] = "trinary"


def check_no_image(path: Path) -> None:
    """Raise ValueError if a path is a map image instead of a YAML file."""
    if path.suffix.lower() in IMAGE_SUFFIXES and path.is_file():
        beside = [str(other) for other in (path.with_suffix(".yaml"), path.with_suffix(".yml")) if other.is_file()]
        advice = f"such as {beside[0]}" if beside else "but none was found"
        raise ValueError(f"{path} is an image; name the YAML file of the map, {advice}")


def map_paths(path: Path) -> tuple[Path, Path]:
    """Return the image path and the YAML path of a saved map; ValueError for an unknown suffix."""
    if path.suffix not in ("", ".yaml", ".yml", ".pgm", ".png"):
        raise ValueError(f"a map is saved as .yaml, .pgm or .png, got {path}")
    image_path = path if path.suffix in (".pgm", ".png") else path.with_suffix(".pgm")
    return image_path, path if path.suffix in (".yaml", ".yml") else path.with_suffix(".yaml")


def save_map(grid: OccupancyGrid, path: str | Path, mode: Literal["trinary", "scale"] = "trinary") -> Path:
    """Save an occupancy grid in map_server format; return the path of the YAML file.

    Args:
        grid: map to save.
        path: `NAME`, `NAME.yaml`, `NAME.pgm` or `NAME.png`.
        mode: `trinary` writes 254 for free, 0 for occupied and 205 for unknown cells, as map_saver does. `scale` keeps
            percentages in a PNG, with transparent unknown cells.

    Raises:
        ValueError: the suffix or mode is invalid, or `scale` is used with PGM.
        OSError: writing failed.
    """
    image_path, yaml_path = map_paths(Path(path))
    if mode == "scale" and Path(path).suffix not in (".pgm", ".png"):
        image_path = image_path.with_suffix(".png")
    if mode not in ("trinary", "scale") or (mode == "scale" and image_path.suffix == ".pgm"):
        raise ValueError(f"maps are saved in mode trinary, or scale as .png, got {mode!r} for {image_path}")
    if mode == "trinary":
        pixels = np.full(grid.data.shape, SAVED_UNKNOWN, dtype=np.uint8)
        pixels[grid.free], pixels[grid.occupied] = 254, 0
    else:
        greys = np.rint(2.55 * (100.0 - np.arange(101))).astype(np.uint8)
        pixels = np.stack([greys[grid.data.clip(0)], np.where(grid.data < 0, np.uint8(0), np.uint8(255))], axis=2)
    image = io.BytesIO()
    content = {
        "image": image_path.name,
        "resolution": float(grid.resolution),
        "origin": [*map(float, grid.origin), 0.0],
        "negate": 0,
        "occupied_thresh": OCCUPIED_THRESH if mode == "trinary" else 1.0,
        "free_thresh": FREE_THRESH if mode == "trinary" else 0.0,
        "mode": mode,
    }
    file_format = "PNG" if image_path.suffix == ".png" else "PPM"  # Pillow's name for PGM
    Image.fromarray(np.ascontiguousarray(pixels[::-1])).save(image, format=file_format)
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None)
    for target, written in ((image_path, image.getvalue()), (yaml_path, text)):
        try:
            write_file(target, written)
        except OSError as error:
            raise OSError(error.errno, f"cannot save {target}: {error.strerror}") from error
    return yaml_path


def load_map(path: str | Path) -> OccupancyGrid:
    """Load a map from a YAML file, with map_server's modes `trinary`, `scale` and `raw`.

    Older Nav2 versions write a `free_thresh` of 0.25, which makes grey 205 (unknown) free in map_server. Here grey 205
    stays unknown in images from map_saver, and a warning is logged.

    Raises:
        ValueError: the YAML or image is damaged, or the map is rotated.
        FileNotFoundError: the YAML file or image is missing.
    """
    path = Path(path)
    check_no_image(path)
    file = read_record(path, MapFile)
    if abs(math.remainder(file.origin[2], 2.0 * math.pi)) > MAX_YAW:
        raise ValueError(f"{path}: origin has a yaw of {file.origin[2]} rad; only 0 is allowed, rotate the image")
    if not file.free_thresh < file.occupied_thresh:
        raise ValueError(f"{path}: free_thresh {file.free_thresh} must lie below {file.occupied_thresh}")
    data = _read_image(path, file)
    return OccupancyGrid(np.ascontiguousarray(data[::-1]), file.resolution, (file.origin[0], file.origin[1]))


def _read_image(source: Path, file: MapFile) -> np.ndarray:
    """Read a map image as occupancy: shape of the image, int8 [percent], -1 for unknown."""
    path = source.parent / file.image
    if not os.path.isfile(path):  # False for invalid paths
        raise FileNotFoundError(f"{source}: there is no map image {str(path)[:300]}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of damaged and of large images
            check_file(path, MAX_IMAGE_BYTES)
            with Image.open(path, formats=IMAGE_FORMATS) as image:
                if image.width * image.height > MAX_CELLS:
                    raise ValueError(f"{image.width} x {image.height} pixels; at most {MAX_CELLS:,} are allowed")
                is_deep = image.mode.startswith("I")
                alpha = np.asarray(image.convert("RGBA"))[..., 3] if image.has_transparency_data else None
                plain = image.mode in ("L", "I", "I;16", "I;16B")
                array = np.asarray(image if plain else image.convert("RGB"))
    except PermissionError:
        raise
    except Exception as error:  # many types for damaged files
        said = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(f"{source}: map image {path} cannot be read: {said}") from error
    is_transparent = None if alpha is None or alpha.min(initial=255) == 255 else alpha < 255
    if array.ndim == 3:
        index, grey = array.sum(axis=2, dtype=np.uint16), np.arange(766) / 3
    elif is_deep:
        index, grey = array.clip(0, 65535), np.arange(65536) / 257
    else:
        index, grey = array, np.arange(256.0)
    data = _interpret(grey, file)[index]
    if is_transparent is not None and file.mode == "trinary":
        if array.ndim == 2:
            index, grey = np.rint(3 * grey)[index].astype(np.uint16), np.arange(766) / 3
        data = _interpret(np.arange(1021) / 4, file)[index + alpha]
    elif is_transparent is not None and file.mode == "scale":
        data[is_transparent] = UNKNOWN
    if file.mode == "trinary" and not file.negate and _interpret(np.array([SAVED_UNKNOWN]), file)[0] == FREE:
        shown = index.ravel() if is_transparent is None else index[~is_transparent]
        counts = np.bincount(shown, minlength=len(grey))
        is_saved = np.abs(grey[:, None] - SAVED_VALUES).min(axis=1) <= SAVED_TOLERANCE
        is_unknown = np.abs(grey - SAVED_UNKNOWN) <= SAVED_TOLERANCE
        if counts[is_unknown].sum() > 0.01 * counts.sum():
            fate = "free; write free_thresh: 0.196 if it means unknown"
            if counts[is_saved].sum() >= SAVED_SHARE * counts.sum():
                data[is_unknown[index]] = UNKNOWN
                fate = "unknown, as written by map_saver"
            text = "%s: free_thresh %g classifies grey 205 as free; it is read as %s"
            logging.getLogger(__name__).warning(text, printable(source), file.free_thresh, fate)
    return data


def _interpret(grey: np.ndarray, file: MapFile) -> np.ndarray:
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

import logging
import math

import numpy as np
from scipy import ndimage

from lidarnaut.envs.files import printable
from lidarnaut.envs.geometry import FREE, OCCUPIED, OCCUPIED_FROM, UNKNOWN, OccupancyGrid, Pose2D
from lidarnaut.envs.geometry.distance_transform import deepest_cell
from lidarnaut.envs.geometry.occupancy_grid import crop_to_known, known_window
from lidarnaut.envs.progress import Progress

from .raster import check_world, outline
from .world import World, kept_with_world

WALL_WIDTH = 0.25
"""The border of a free map area counts as a wall if an occupied cell is at most this far away [m]."""
ENCLOSED_SHARE, EDGE_SHARE = 0.5, 0.2
"""A free map area is enclosed if at least the fraction `ENCLOSED_SHARE` of its border lies along walls, and at most
`EDGE_SHARE` along the map edge."""
DOOR_WIDTH = 1.2
"""Openings up to this width count as doors between rooms [m]."""
MIN_AREA = 1.0
"""Free map areas smaller than this do not count as enclosed, unless all areas are smaller [m2]."""
FREE_SPACE = "in free space of the map"
_PROGRESS_DELAY = 2.0


def world_from_map(grid: OccupancyGrid, name: str, spawn: Pose2D | None = None, source: str = "") -> World:
    """Build a world from one connected free area of a map; all other cells become solid.

    The area is the one that contains `spawn`. Without a spawn, it is the largest enclosed area, or else the largest
    area, and the spawn is the point farthest from obstacles.

    Raises:
        ValueError: the map has no free cell, or the spawn is not in a free cell.
    """
    with Progress(total=4, desc=f"world of map {name}", unit="step", delay=_PROGRESS_DELAY, leave=False) as bar:
        labels, count = ndimage.label(grid.free)
        if count == 0:
            raise ValueError(f"map {name!r} has no free cell")
        sizes = np.bincount(labels.ravel())[1:] * grid.resolution**2
        if spawn is not None:
            label = _value_at(labels, grid, spawn)
            if label <= 0:
                raise ValueError(f"spawn {tuple(spawn)} of map {name!r} lies {class_at(grid, spawn)}")
        else:
            label, is_enclosed = _choose_area(grid, labels, sizes)
        area = np.pad(labels == label, 1)
        bar.update()
        if spawn is None:
            inside = area if is_enclosed else _largest_room(grid, area)
            x, y = grid.centers(np.array(deepest_cell(inside)) - 1)
            spawn = Pose2D(float(x), float(y), 0.0)
        bar.update()
        height, width = grid.data.shape
        xs = grid.origin[0] + grid.resolution * np.arange(width + 1)
        ys = grid.origin[1] + grid.resolution * np.arange(height + 1)
        segments = outline(~area[1:-1, 1:-1], xs, ys)
        bar.update()
        sides = segments[:, ::2], segments[:, 1::2]
        text = f"{sizes[label - 1]:.1f} m2 around the spawn ({spawn.x:.2f}, {spawn.y:.2f})"
        if count > 1:
            rest = sizes.sum() - sizes[label - 1]
            text += f"; left out: {rest:.1f} m2 in {count - 1} other areas"
        world = World(
            name=name,
            segments=segments,
            circles=np.empty((0, 3)),
            spawns=(spawn,),
            bounds=(*(float(side.min()) for side in sides), *(float(side.max()) for side in sides)),  # type: ignore[arg-type]
            source=source,
            notes=text,
            map=grid,
        )
        checked = check_world(world)
    level = logging.INFO if sizes[label - 1] == sizes.max() else logging.WARNING
    logging.getLogger(__name__).log(level, "world of map %s: %s", printable(name), text)
    return checked


def _value_at(values: np.ndarray, grid: OccupancyGrid, pose: Pose2D) -> int:
    cell = grid.cells(np.array(pose[:2]))
    return int(values[tuple(cell)]) if grid.contains(cell) else -2


def class_at(grid: OccupancyGrid, pose: Pose2D) -> str:
    """Return a phrase for error messages: whether a pose is in free, occupied or unknown space or outside the map."""
    value = _value_at(grid.data, grid, pose)
    if value < 0:
        return "in unknown space of the map" if value == UNKNOWN else f"outside of the map, which covers {grid.bounds}"
    return "in an obstacle of the map" if value >= OCCUPIED_FROM else FREE_SPACE


def _choose_area(grid: OccupancyGrid, labels: np.ndarray, sizes: np.ndarray, margin: float = 0.0) -> tuple[int, bool]:
    """Return the label of the largest enclosed free area and True, otherwise that of the largest area and False."""
    reach, rim = (math.ceil(min(gap / grid.resolution, max(labels.shape))) for gap in (margin + WALL_WIDTH, margin))
    is_open = ndimage.minimum_filter((grid.data < OCCUPIED_FROM).astype(np.uint8), 2 * reach + 1, mode="nearest")
    kinds = np.full((labels.shape[0] + 2, labels.shape[1] + 2), 2)  # neighbours of an area: 0 open, 1 wall, 2 map edge
    inner = slice(rim + 1, -rim - 1), slice(rim + 1, -rim - 1)
    kinds[inner] = np.pad(is_open == 0, 1)[inner]
    padded, counts = np.pad(labels, 1), np.zeros((len(sizes) + 1) * 3)
    for rows, cols in ((slice(2, None), slice(1, -1)), (slice(None, -2), slice(1, -1))):
        for beside in ((rows, cols), (cols, rows)):
            is_border = (labels > 0) & (padded[beside] == 0)
            counts += np.bincount(3 * labels[is_border] + kinds[beside][is_border], minlength=len(counts))
    shares = counts.reshape(-1, 3)[1:] / np.maximum(counts.reshape(-1, 3)[1:].sum(axis=1, keepdims=True), 1.0)
    is_enclosed = (shares[:, 1] >= ENCLOSED_SHARE) & (shares[:, 2] <= EDGE_SHARE)
    is_enclosed &= sizes >= min(MIN_AREA, sizes.max())
    best = int(np.argmax(np.where(is_enclosed, sizes, 0.0) if is_enclosed.any() else sizes))
    return 1 + best, bool(is_enclosed[best])


def _largest_room(grid: OccupancyGrid, area: np.ndarray) -> np.ndarray:
    rooms, count = ndimage.label(ndimage.distance_transform_edt(area) * grid.resolution > 0.5 * DOOR_WIDTH)
    if count < 2:
        return area
    sizes = np.bincount(rooms.ravel())[1:] * grid.resolution**2
    room, is_enclosed = _choose_area(grid, rooms[1:-1, 1:-1], sizes, 0.5 * DOOR_WIDTH)
    return rooms == room if is_enclosed else area


@kept_with_world
def _areas(world: World) -> np.ndarray:
    assert world.map is not None
    labels: np.ndarray = ndimage.label(world.map.free)[0]
    return labels


def area_around(world: World, pose: Pose2D) -> World:
    """Return the world built from the free map area that contains a pose.

    Return `world` if it has no map, or the pose is in no free area.
    """
    if world.map is None:
        return world
    labels = _areas(world)
    label = _value_at(labels, world.map, pose)
    return world if label <= 0 or label == _value_at(labels, world.map, world.spawns[0]) else _other_area(world, label)


@kept_with_world
def _other_area(world: World, label: int) -> World:
    assert world.map is not None
    cell = np.array(deepest_cell(np.pad(_areas(world) == label, 1))) - 1
    x, y = world.map.centers(cell).tolist()
    return world_from_map(world.map, world.name, Pose2D(x, y, 0.0), world.source)


@kept_with_world
def left_out(world: World) -> OccupancyGrid:
    """Return a grid that marks the map's free areas outside the world with 100, and other cells with 0.

    The grid covers the known part of the map.
    """
    assert world.map is not None
    labels, known = _areas(world), crop_to_known(world.map, margin=0)
    is_out = (labels > 0) & (labels != _value_at(labels, world.map, world.spawns[0]))
    data = np.where(is_out, np.int8(OCCUPIED), np.int8(FREE))[known_window(world.map.data).slices]
    return OccupancyGrid(np.ascontiguousarray(data), known.resolution, known.origin)

"""Bags of ROS 1 and ROS 2 that are damaged: the values of their messages, or the bytes of their files."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.convert import convert
from rosbags.rosbag2 import StoragePlugin, Writer

from envs.geometry import Pose2D
from envs.logs import messages
from envs.robots import LidarParams, Mount
from envs.simulation import Twist

from .damage import damage_bytes

LIDAR = LidarParams(num_beams=5, range_max=8.0, fov=2.0)
EDGES: dict[type, tuple[Any, ...]] = {
    float: (0.0, -0.0, -1.0, 0.5, 1e5, 3e38, -3e38, 1e-40, np.inf, -np.inf, np.nan),
    int: (0, 1, 10**6, 2**31 - 1),
    str: ("", "/", "x" * 5000, "\x00", "odom", "base_footprint", "laser", "map"),
}
"""Values that programs forget and messages can hold, by type: numbers of 32 bits, times, frames."""


def write_damaged_bag(folder: Path, name: str, rng: np.random.Generator) -> Path:
    """Write a bag of a few scans in one of three formats, damaged at random, and return its path."""
    pairs = list(_drive())
    suffix = (".bag", ".mcap", "")[rng.integers(3)]
    is_content_damaged = rng.random() < 0.5
    if is_content_damaged:
        slots = [slot for _, message in pairs for slot in _slots(message)]
        for number in rng.integers(len(slots), size=rng.integers(1, 4)):
            _damage(*slots[number], rng)
        del pairs[rng.integers(len(pairs) + 1) :][: rng.integers(2)]
    # ROS 1 (`.bag`), ROS 2 in one file (`.mcap`), or in a folder with SQLite (no suffix).
    plugin = StoragePlugin.MCAP if suffix == ".mcap" else StoragePlugin.SQLITE3
    written, store = folder / (name if suffix == "" else "written"), messages.typestore()
    with Writer(written, version=8, storage_plugin=plugin) as writer:
        topics = {topic: message.__msgtype__ for topic, message in pairs}
        connections = {topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in topics.items()}
        for k, (topic, message) in enumerate(pairs):
            writer.write(connections[topic], k * 10**8, store.serialize_cdr(message, topics[topic]))
    path = folder / f"{name}{suffix}"
    if suffix == ".mcap":
        (written / "written.mcap").rename(path)
    elif suffix == ".bag":
        convert([written], path, "", 0, None, "", store, None, (), (), (), ())
    if not is_content_damaged:
        files = [path] if path.is_file() else sorted(path.iterdir())
        file = files[rng.integers(len(files))]
        file.write_bytes(damage_bytes(file.read_bytes(), rng))
    return path


def _drive() -> Iterator[tuple[str, Any]]:
    """Yield topics and messages of a drive along x with five scans."""
    yield "/tf_static", messages.static_transforms(Mount(x=0.1))
    for k in range(6):
        yield "/odom", messages.odometry(0.1 * k, Pose2D(0.05 * k, 0.0, 0.0), Twist(0.5, 0.0))
        yield "/tf", messages.transforms(0.1 * k, Pose2D(0.0, 0.0, 0.0), Pose2D(0.05 * k, 0.0, 0.0))
        yield "/scan", messages.laser_scan(0.1 * k, np.full(5, 2.0, dtype=np.float32), LIDAR, 0.1)


def _slots(message: Any) -> Iterator[tuple[Any, Any]]:
    """Yield every part of a message that holds values, with the name of each."""
    for field in dataclasses.fields(message):
        value = getattr(message, field.name)
        if isinstance(value, float | int | str | np.ndarray) and field.name != "__msgtype__":
            yield message, field.name
        for one in value if isinstance(value, list) else [value]:
            if dataclasses.is_dataclass(one):
                yield from _slots(one)


def _damage(holder: Any, name: str, rng: np.random.Generator) -> None:
    value = getattr(holder, name)
    if isinstance(value, np.ndarray):
        damaged = value[: rng.integers(len(value) + 1)] if value.dtype == np.float32 else value.copy()
        if len(damaged):
            damaged[rng.integers(len(damaged))] = EDGES[float][rng.integers(len(EDGES[float]))]
        setattr(holder, name, damaged)
    else:
        edges = EDGES[type(value)]
        setattr(holder, name, edges[rng.integers(len(edges))])

"""Reading of ROS 1 and ROS 2 bags."""

import bz2
import contextlib
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
from rosbags import rosbag1, rosbag2
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import storage_mcap
from rosbags.typesys import Stores, get_typestore

from lidarnaut.envs.files import check_file, read_mapping

MAX_TEXT = 1000
"""Maximum length of an error message [characters]."""

MAX_CHUNK = 2**29
"""Maximum decompressed size of a chunk or message [bytes]."""


def _bounded(make_decompressor: Callable[[], Any]) -> Callable[..., bytes]:

    def unpack(data: bytes, *_: int) -> bytes:
        decompressor = make_decompressor()
        content: bytes = decompressor.decompress(data, max_length=MAX_CHUNK + 1)
        if len(content) > MAX_CHUNK or not decompressor.eof:
            raise ValueError(f"a chunk is truncated, or unpacks to more than {MAX_CHUNK:,} bytes")
        return content

    return unpack


_lz4, _zstd = _bounded(LZ4FrameDecompressor), _bounded(rosbag2.reader.zstd.ZstdDecompressor)
rosbag1.reader.decompressors.update(bz2=_bounded(bz2.BZ2Decompressor), lz4=_lz4)
storage_mcap.DECOMPRESSORS.update(lz4=_lz4, zstd=_zstd)
rosbag2.reader.zstd = SimpleNamespace(open=rosbag2.reader.zstd.open, decompress=_zstd)  # type: ignore[assignment]


class _Folder(type(Path())):  # type: ignore[misc]
    """Folder path that hides a suffix `.bag`, as `rosbags` takes such paths for ROS 1 bags."""

    @property
    def suffix(self) -> str:
        suffix: str = super().suffix
        return "" if suffix == ".bag" else suffix


class BagError(ValueError):
    """Error: a ROS bag cannot be read as a log."""


class BagReader:
    """Reader of a ROS bag's messages by topic."""

    def __init__(self, path: Path, reader: AnyReader) -> None:
        self.path = path
        self._reader = reader
        self.types: dict[str, str] = {c.topic: c.msgtype for c in reader.connections}
        self._counts: dict[str, int] = {}
        for connection in reader.connections:
            self._counts[connection.topic] = self._counts.get(connection.topic, 0) + connection.msgcount

    def topics(self, kinds: Sequence[str]) -> list[str]:
        return sorted(topic for topic, kind in self.types.items() if kind in kinds and self._counts[topic])

    def choose(self, kinds: Sequence[str], wanted: str | None, option: str) -> str:
        """Return the name of the `wanted` topic; if None, of the only topic with a message type in `kinds`."""
        found = self.topics(kinds)
        allowed = found if wanted is None else [topic for topic in (wanted, f"/{wanted}") if topic in found]
        if not allowed:
            listing = ", ".join(f"{t} ({kind}, {self._counts[t]} messages)" for t, kind in sorted(self.types.items()))
            what = "" if wanted is None else f"{option} {wanted} "
            raise self.error(f"{what}holds no {' or '.join(kinds)}; there are {listing or 'no topics'}")
        if wanted is None and len(found) > 1:
            choice = f"choose one by {option} (--{option.replace('_', '-')})"
            raise self.error(f"{len(found)} topics hold {kinds[0]}: {', '.join(found)}; {choice}")
        return allowed[0]

    def messages(self, topic: str) -> Iterator[Any]:
        """Yield the messages of a topic; BagError if messages are missing."""
        count = 0
        for connection, _, raw in self._reader.messages([c for c in self._reader.connections if c.topic == topic]):
            yield self._reader.deserialize(raw, connection.msgtype)
            count += 1
        if count < self._counts[topic]:
            raise self.error(f"damaged: holds {count} of {self._counts[topic]} messages of {topic}")

    def error(self, text: str) -> BagError:
        return BagError(f"{self.path}: {text if len(text) <= MAX_TEXT else text[:MAX_TEXT] + '...'}")


@contextlib.contextmanager
def open_bag(path: Path) -> Iterator[BagReader]:
    """Open a ROS bag for reading.

    Raises:
        BagError: not a bag, or damaged (also raised while reading).
        ValueError: a file is not regular, or the metadata are too large or nested.
        PermissionError: the file is not readable.
    """
    if path.is_dir():
        read_mapping(path / "metadata.yaml")
    for file in path.glob("*") if path.is_dir() else [path]:
        if not file.is_dir():
            check_file(file, math.inf)
    try:
        # SQLite bags before ROS 2 Iron lack message definitions.
        where = _Folder(path) if path.is_dir() else path
        with AnyReader([where], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
            yield BagReader(path, reader)
    except (BagError, PermissionError):
        raise
    except Exception as error:  # many types
        said = " ".join(str(error).split()) or type(error).__name__
        raise BagError(f"{path}: damaged or not a bag: {said}") from error

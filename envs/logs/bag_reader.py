"""Reading of ROS 1 and ROS 2 bags."""

import bz2
import contextlib
import functools
import heapq
import importlib.util
import math
import os
import shutil
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import groupby
from operator import attrgetter, itemgetter
from pathlib import Path, PurePath
from typing import Any

from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
from rosbags import rosbag2
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag2 import storage_sqlite3
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.msg import normalize_msgtype

from lidarnaut.envs.files import check_file, read_mapping

from .messages import typestore

SCAN = "sensor_msgs/msg/LaserScan"
ODOMETRY = "nav_msgs/msg/Odometry"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
NEEDED = (SCAN, ODOMETRY, *TRANSFORMS)
MAX_TEXT = 1000
"""Maximum length of an error message [characters]."""
MAX_CHUNK = 2**29
"""Maximum decompressed size of a chunk or message [bytes]."""
MCAP_MAGIC, FOOTER_SIZE = b"\x89MCAP0\r\n", 37


def _bounded(make_decompressor: Callable[[], Any]) -> Callable[..., bytes]:
    def unpack(data: bytes, *_: int) -> bytes:
        decompressor = make_decompressor()
        content: bytes = decompressor.decompress(data, max_length=MAX_CHUNK + 1)
        if len(content) > MAX_CHUNK or not decompressor.eof:
            raise ValueError(f"a chunk is truncated, or unpacks to more than {MAX_CHUNK:,} bytes")
        return content

    return unpack


def _copy_of(module: str) -> Any:
    """Return a copy of a module, whose functions may be replaced without effect on other readers of the process."""
    spec: Any = importlib.util.find_spec(module)
    copy = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(copy)
    return copy


_lz4, _zstd = _bounded(LZ4FrameDecompressor), _bounded(rosbag2.reader.zstd.ZstdDecompressor)
_rosbag1, _mcap = _copy_of("rosbags.rosbag1.reader"), _copy_of("rosbags.rosbag2.storage_mcap")
_rosbag1.decompressors.update(bz2=_bounded(bz2.BZ2Decompressor), lz4=_lz4)
_mcap.DECOMPRESSORS.update(lz4=_lz4, zstd=_zstd)
# Definitions in bags are not used, as they may be missing, broken, binary (Protobuf) or of other kinds (JSON): the
# needed types are the same in all releases of ROS.
_UNDEFINED, _read_text = MessageDefinition(MessageDefinitionFormat.NONE, ""), _mcap.read_bytes
_mcap.get_msgdef, _mcap.get_qos = lambda *_: _UNDEFINED, lambda *_: []
_mcap.read_string = lambda bio: _read_text(bio).decode(errors="replace")
_McapReader: Any = _mcap.McapReader


class _Mcap(_McapReader):
    """MCAP reader without the limits of `rosbags` on profiles, indexes, and the order of messages."""

    connections: list[Connection]

    def _open(self) -> None:
        file: Any = self.bio
        if file.read(9) != MCAP_MAGIC + b"\x01":
            raise ValueError("does not begin as an MCAP file")
        _mcap.read_sized(file)  # profile and library
        self.data_start = file.tell()
        end, footer = file.seek(-FOOTER_SIZE, os.SEEK_END), file.read()
        if footer[-8:] != MCAP_MAGIC:
            raise ValueError("its end is missing, as after a crash of the recorder; `mcap recover` repairs it")
        if summary := int.from_bytes(footer[9:17], "little"):
            self.data_end = summary
            self.read_index()
        found, self.data_end = self.statistics, summary or end
        counts = found.channel_message_counts if found else {}
        sizes = len(self.schemas), len(self.channels), sum(counts.values())
        if not found or sizes != (found.schema_count, found.channel_count, found.message_count):
            self.connections.clear()
            self.meta_scan()
            counts = self.statistics.channel_message_counts
        self.connections = [each._replace(msgcount=counts.get(each.id, 0)) for each in self.connections]

    def messages(self, connections: Any, *_: Any) -> Any:
        if self.chunks and all(chunk.channel_count for chunk in self.chunks):
            return super().messages(connections)
        return sorted(self.messages_scan(connections), key=itemgetter(1))


class _Sqlite(storage_sqlite3.Sqlite3Reader):
    """SQLite reader that ignores message definitions; `rosbags` refuses those that the recorder did not find."""

    def _open(self) -> None:
        rows: Any = self.dbconn.execute(  # type: ignore[union-attr]
            "SELECT topics.id, name, type, serialization_format, count(messages.id) FROM topics "
            "LEFT JOIN messages ON topics.id == messages.topic_id GROUP BY topics.id ORDER BY topics.id"
        )
        self.connections = [
            Connection(key, topic, kind, _UNDEFINED, "", count, ConnectionExtRosbag2(encoding, []), self)
            for key, topic, kind, encoding, count in rows
        ]


@functools.cache
def _types_of_ros1() -> Any:
    store = get_typestore(Stores.ROS1_NOETIC)
    for kind in TRANSFORMS:
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", kind))
    return store


_DECODERS: dict[str, Callable[[bytes, str], Any]] = {
    "cdr": lambda raw, kind: typestore().deserialize_cdr(raw, kind),
    "ros1": lambda raw, kind: _types_of_ros1().deserialize_ros1(raw, kind),
}


class BagError(ValueError):
    """Error: a ROS bag cannot be read as a log."""


class BagReader:
    """Reader of a ROS bag's scans, odometry and transforms by topic."""

    def __init__(self, path: Path, files: Sequence[Any], is_packed: bool) -> None:
        """`files`: open readers of `rosbags`. `is_packed`: whether messages are compressed one by one."""
        self.path = path
        self._is_packed = is_packed
        found: list[Connection] = [each for file in files for each in file.connections]
        self._connections = [c._replace(msgtype=normalize_msgtype(c.msgtype)) if "/" in c.msgtype else c for c in found]

    def topics(self, kinds: Sequence[str]) -> list[str]:
        """Return the topics with messages of the types `kinds`."""
        return sorted({each.topic for each in self._find(kinds)})

    def foreign(self, kinds: Sequence[str], topics: Sequence[str] = ()) -> str:
        """Return a list of topics (default: all) of the types `kinds` whose encoding is not supported."""
        return _listing(c for c in self._find(kinds, is_foreign=True) if not topics or c.topic in topics)

    def choose(self, kinds: Sequence[str], wanted: str | None, option: str) -> str:
        """Return the name of the `wanted` topic; if None, of the only topic with a message type in `kinds`."""
        found, names = self.topics(kinds), () if wanted is None else (wanted, f"/{wanted}")
        allowed = [topic for topic in found if not names or topic in names]
        if not allowed and (foreign := self.foreign(kinds, names)):
            raise self.error(f"only encodings {' and '.join(_DECODERS)} can be read, not {foreign}")
        if not allowed:
            what = "" if wanted is None else f"{option} {wanted} "
            listing = _listing(self._connections) or "no topics"
            raise self.error(f"{what}holds no {' or '.join(kinds)}; there are {listing}")
        if wanted is None and len(found) > 1:
            choice = f"choose one by {option} (--{option.replace('_', '-')})"
            raise self.error(f"{len(found)} topics hold {kinds[0]}: {', '.join(found)}; {choice}")
        return allowed[0]

    def messages(self, topic: str) -> Iterator[Any]:
        """Yield the scans, odometry or transforms of a topic by time of recording; BagError if messages are missing."""
        needed = [each for each in self._find(NEEDED) if each.topic == topic]
        count, files = 0, groupby(needed, attrgetter("owner"))
        streams = [file.messages(list(connections)) for file, connections in files]
        for connection, _, raw in heapq.merge(*streams, key=itemgetter(1)):  # files of a bag may overlap
            raw, decode = _zstd(raw) if self._is_packed else raw, _DECODERS[_encoding(connection)]
            try:
                yield decode(raw, normalize_msgtype(connection.msgtype))
            except SerdeError as error:
                raise self.error(f"damaged: message {count} of {topic}: {error}") from error
            count += 1
        if count < (total := sum(each.msgcount for each in needed)):
            raise self.error(f"damaged: holds {count} of {total} messages of {topic}")

    def error(self, text: str) -> BagError:
        return BagError(f"{self.path}: {text if len(text) <= MAX_TEXT else text[:MAX_TEXT] + '...'}")

    def _find(self, kinds: Sequence[str], *, is_foreign: bool = False) -> list[Connection]:
        found = [each for each in self._connections if each.msgtype in kinds and each.msgcount]
        return [each for each in found if (_encoding(each) in _DECODERS) is not is_foreign]


def _encoding(connection: Connection) -> str:
    return getattr(connection.ext, "serialization_format", "ros1")


def _listing(connections: Iterable[Connection]) -> str:
    counts: Counter[tuple[str, str]] = Counter()
    for each in connections:
        kind, encoding = each.msgtype.replace("__schemaless__", "no schema"), _encoding(each)
        counts[each.topic, kind if encoding in _DECODERS else f"{kind} as {encoding}"] += each.msgcount
    return ", ".join(f"{topic} ({kind}, {count} messages)" for (topic, kind), count in sorted(counts.items()))


@contextlib.contextmanager
def open_bag(path: Path) -> Iterator[BagReader]:
    """Open a ROS bag for reading.

    Raises:
        BagError: not a bag, or damaged (also raised while reading).
        ValueError: a file is not regular, or the metadata are too large or nested.
        PermissionError: the file is not readable.
    """
    metadata = read_mapping(path / "metadata.yaml") if path.is_dir() else None
    for file in path.glob("*") if path.is_dir() else [path]:
        if not file.is_dir():
            check_file(file, math.inf)
    try:
        with contextlib.ExitStack() as stack:
            files, is_packed = _files_of(path, metadata, stack)
            for file in files:
                file.open()
                stack.callback(file.close)
            yield BagReader(path, files, is_packed)
    except (BagError, PermissionError):
        raise
    except Exception as error:  # many types
        said = " ".join(str(error).split()) or type(error).__name__
        raise BagError(f"{path}: {'' if 'upported' in said else 'damaged or not a bag: '}{said}") from error


def _files_of(path: Path, metadata: Any, stack: contextlib.ExitStack) -> tuple[list[Any], bool]:
    if metadata is None:
        return [_rosbag1.Reader(path) if path.suffix == ".bag" else _Mcap(path)], False
    about = metadata["rosbag2_bagfile_information"]
    storage, packing = about["storage_identifier"], (about.get("compression_mode") or "none").lower()
    if storage not in (readers := {"mcap": _Mcap, "sqlite3": _Sqlite}):
        raise ValueError(f"storage {storage} is not supported, but {' and '.join(readers)} are")
    if packing != "none" and about["compression_format"] != "zstd":
        raise ValueError(f"compression {about['compression_format']} is not supported, but zstd is")
    files = [path / PurePath(name).name for name in about["relative_file_paths"]]
    if packing == "file":
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        for k, file in enumerate(files):
            files[k] = folder / file.stem
            with rosbag2.reader.zstd.open(file, "rb") as packed, files[k].open("wb") as unpacked:
                shutil.copyfileobj(packed, unpacked)
    return [readers[storage](file) for file in files], packing == "message"

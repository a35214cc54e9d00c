"""Writer of MCAP files (https://mcap.dev/spec) with the freedoms of the format that `rosbags` does not write."""

import struct
from io import BytesIO

import lz4.frame
from rosbags.rosbag2 import storage_mcap
from rosbags.typesys import Stores

from tests.logs.bags import Messages

MAGIC = b"\x89MCAP0\r\n"
PACK = {"": bytes, "lz4": lz4.frame.compress, "zstd": storage_mcap.zstd.compress}


def record(op, form="", *values, rest=b""):
    body = struct.pack(f"<{form}", *values) + rest
    return bytes([op]) + struct.pack("<Q", len(body)) + body


def text(content):
    content = content if isinstance(content, bytes) else content.encode()
    return struct.pack("<I", len(content)) + content


def channel_of(store, topic, kind, encoding="cdr", schema="ros2msg", definition=None):
    """Return (topic, encoding, schema's name, its encoding, its data); metadata may follow."""
    if definition is None:
        definition = store.generate_msgdef(kind, ros_version=1 if schema == "ros1msg" else 2)[0]
    name = kind.replace("/msg/", "/") if schema == "ros1msg" else kind
    return topic, encoding, name, schema, definition


def pack_chunk(content, offsets, compression, start, indexed):
    """Return a chunk that begins at `start` with its message indexes, and its record in the index of chunks.

    `offsets`: times [ns] and offsets of messages by channel.
    """
    times = [time for rows in offsets.values() for time, _ in rows]
    packed, index = PACK[compression](content), {}
    head = struct.pack("<QQQI", min(times), max(times), len(content), 0) + text(compression)
    data = record(6, rest=head + struct.pack("<Q", len(packed)) + packed)
    length = len(data)
    for key, rows in offsets.items() if indexed else ():
        index[key] = start + len(data)
        data += record(7, "H", key, rest=text(b"".join(struct.pack("<QQ", *row) for row in rows)))
    tail = text(b"".join(struct.pack("<HQ", *row) for row in index.items()))
    tail += struct.pack("<Q", len(data) - length) + text(compression) + struct.pack("<QQ", len(packed), len(content))
    return data, record(8, "QQQQ", min(times), max(times), start, length, rest=tail)


def write_mcap(
    path,
    channels,
    messages,
    *,
    profile="ros2",
    compression=None,
    statistics=True,
    summary=True,
    repeats_schemas=True,
    indexed=True,
    per_chunk=4,
):
    """Write a file.

    Args:
        path: path of the file.
        channels: see `channel_of`; a channel whose schema has no name has no schema.
        messages: (topic, time [ns], bytes).
        profile: profile of the header.
        compression: None without chunks, "" for uncompressed chunks, "lz4" or "zstd".
        statistics, summary, repeats_schemas, indexed: whether the file has these parts.
        per_chunk: number of messages in a chunk.
    """
    schemas, described, ids, counts = [], [], {}, {}
    for k, (topic, encoding, name, schema, data, *metadata) in enumerate(channels, start=1):
        if name:
            schemas.append(record(3, "H", k, rest=text(name) + text(schema) + text(data)))
        described.append(
            record(4, "HH", k, k if name else 0, rest=text(topic) + text(encoding) + text(*metadata or [""]))
        )
        ids[topic, encoding] = k
    by_topic = {topic: k for (topic, _), k in ids.items()}
    file = BytesIO()
    file.write(MAGIC + record(1, rest=text(profile) + text("")))
    step = len(messages) if compression is None else per_chunk
    chunks = []
    for first in range(0, len(messages), max(step, 1)):
        part, offsets = BytesIO(), {}
        part.write(b"".join(schemas + described))
        for topic, time, data in messages[first : first + step]:
            key = ids[topic] if isinstance(topic, tuple) else by_topic[topic]
            offsets.setdefault(key, []).append((time, part.tell()))
            counts[key] = counts.get(key, 0) + 1
            part.write(record(5, "HIQQ", key, 0, time, time, rest=data))
        if compression is None:
            file.write(part.getvalue())
            continue
        data, chunk = pack_chunk(part.getvalue(), offsets, compression, file.tell(), indexed)
        file.write(data)
        chunks.append(chunk)
    file.write(record(15, "I", 0))
    start = file.tell()
    if summary:
        file.write(b"".join((schemas if repeats_schemas else []) + described + chunks))
        flat = text(b"".join(struct.pack("<HQ", *row) for row in counts.items()))
        times = [time for _, time, _ in messages] or [0]
        sizes = len(messages), len(schemas), len(channels), 0, 0, len(chunks), min(times), max(times)
        file.write(record(11, "QHIIIIQQ", *sizes, rest=flat) if statistics else b"")
    file.write(record(2, "QQI", start if summary else 0, 0, 0) + MAGIC)
    path.write_bytes(file.getvalue())
    return path


def drive(encoding="cdr", times=(101, 102, 103), schema=None, odometry=None):
    """Return channels and messages of scans and odometry, 1 s apart, in an encoding of ROS."""
    is_ros1 = encoding == "ros1"
    maker = Messages(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_JAZZY)
    pack = maker.store.serialize_ros1 if is_ros1 else maker.store.serialize_cdr
    schema = schema or ("ros1msg" if is_ros1 else "ros2msg")
    kinds = {"/scan": "sensor_msgs/msg/LaserScan", "/odom": "nav_msgs/msg/Odometry"}
    channels = [channel_of(maker.store, topic, kind, encoding, schema) for topic, kind in kinds.items()]
    messages = []
    for time in times:
        for made in (maker.scan(time, [1.0, 2.0, 3.0]), maker.odometry(time, 0.1 * (time - 101), 0.0, 0.0)):
            topic = "/scan" if "LaserScan" in made.__msgtype__ else "/odom"
            messages.append((topic, time * 10**9, bytes(pack(made, made.__msgtype__))))
    return channels, messages

"""Bags by rosbags and mcap."""

from collections import defaultdict
from pathlib import Path

from client import plain
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer
from mcap_ros2.decoder import DecoderFactory
from rosbags.convert import convert
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from ruamel.yaml import YAML

STORE = get_typestore(Stores.ROS2_JAZZY)
FORMS_OF_MCAP = {
    "chunks of 1 kB in LZ4": {"chunk_size": 1024, "compression": CompressionType.LZ4},
    "chunks without compression": {"compression": CompressionType.NONE},
    "no chunks": {"use_chunking": False},
    "no index": {"index_types": IndexType.NONE},
    "no statistics": {"use_statistics": False, "use_summary_offsets": False, "repeat_channels": False},
}
FORMS_OF_ROSBAGS = {
    "SQLite": ("sqlite3", None, "none"),
    "SQLite with compressed files": ("sqlite3", "zstd", "file"),
    "SQLite with compressed messages": ("sqlite3", "zstd", "message"),
    "ROS 1": ("", None, "none"),
    "ROS 1 in BZ2": ("", "bz2", "none"),
    "ROS 1 in LZ4": ("", "lz4", "none"),
}
"""Storage, compression and its mode."""


def rosbags(path):
    """Return the messages by topic, with the time of recording [ns], and the latched topics."""
    messages, latched = defaultdict(list), set()
    with AnyReader([Path(path)], default_typestore=STORE) as reader:
        for one in reader.connections:
            durabilities = {profile.durability.name for profile in one.ext.offered_qos_profiles}
            latched |= {one.topic} if "TRANSIENT_LOCAL" in durabilities else set()
        for connection, time, raw in reader.messages():
            messages[connection.topic].append([time, plain(reader.deserialize(raw, connection.msgtype))])
    return {"messages": messages, "latched": sorted(latched)}


def mcap(path):
    """Return the messages by topic, with the time of recording [ns], and the latched topics."""
    messages, latched = defaultdict(list), set()
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages():
            messages[channel.topic].append([message.log_time, plain(decoded)])
            profiles = YAML(typ="safe").load(channel.metadata.get("offered_qos_profiles", "")) or []
            latched |= {channel.topic for profile in profiles if profile["durability"] in (1, "transient_local")}
    return {"messages": messages, "latched": sorted(latched)}


def write(source, folder):
    """Write the messages of an MCAP bag in other forms; return the paths by form."""
    folder, found = Path(folder), {}
    for name, options in FORMS_OF_MCAP.items():
        found[f"mcap, {name}"] = path = folder / f"{name}.mcap"
        with open(source, "rb") as read, path.open("wb") as file:
            writer, channels = Writer(file, **options), {}
            writer.start(profile="ros2")
            for schema, channel, message in make_reader(read).iter_messages():
                if channel.id not in channels:
                    known = writer.register_schema(schema.name, schema.encoding, schema.data)
                    channels[channel.id] = writer.register_channel(channel.topic, "cdr", known, channel.metadata)
                writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time)
            writer.finish()
    every = dict.fromkeys(("exclude_topics", "include_topics", "exclude_msgtypes", "include_msgtypes"), ())
    for name, (storage, packing, mode) in FORMS_OF_ROSBAGS.items():
        found[f"rosbags, {name}"] = path = folder / (name if storage else f"{name}.bag")
        types = None if storage else get_typestore(Stores.ROS1_NOETIC)
        convert([Path(source)], path, storage, 8, packing, mode, STORE, types, **every)
    return {name: str(path) for name, path in found.items()}

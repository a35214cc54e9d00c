"""Bags by rosbags and mcap: `bags.py read LIBRARY PATH`, `bags.py write PATH FOLDER`; prints JSON."""

import json
import sys
from collections import defaultdict
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer
from mcap_ros2.decoder import DecoderFactory
from plain import plain
from rosbags.convert import convert
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from ruamel.yaml import YAML

STORE = get_typestore(Stores.ROS2_JAZZY)


def read(library, path):
    """Return the messages by topic, with the time of recording [ns], and the latched topics."""
    messages, latched = defaultdict(list), set()
    if library == "rosbags":
        with AnyReader([Path(path)], default_typestore=STORE) as reader:
            for one in reader.connections:
                profiles = one.ext.offered_qos_profiles
                latched |= {one.topic for profile in profiles if profile.durability.name == "TRANSIENT_LOCAL"}
            for connection, time, raw in reader.messages():
                messages[connection.topic].append([time, plain(reader.deserialize(raw, connection.msgtype))])
    else:
        with open(path, "rb") as file:
            for _, channel, message, decoded in make_reader(
                file, decoder_factories=[DecoderFactory()]
            ).iter_decoded_messages():
                messages[channel.topic].append([message.log_time, plain(decoded)])
                profiles = YAML(typ="safe").load(channel.metadata.get("offered_qos_profiles", "")) or []
                latched |= {channel.topic for profile in profiles if profile["durability"] in (1, "transient_local")}
    return {"messages": messages, "latched": sorted(latched)}


def write(source, folder):
    """Write the messages of an MCAP bag in other forms; return the paths by form."""
    folder, found, source = Path(folder), {}, Path(source)
    folder.mkdir(parents=True)
    for name, options in {
        "chunks of 1 kB in LZ4": {"chunk_size": 1024, "compression": CompressionType.LZ4},
        "chunks without compression": {"compression": CompressionType.NONE},
        "no chunks": {"use_chunking": False},
        "no index": {"index_types": IndexType.NONE},
        "no statistics": {"use_statistics": False, "use_summary_offsets": False, "repeat_channels": False},
    }.items():
        path = folder / f"{name}.mcap"
        with source.open("rb") as read, path.open("wb") as file:
            writer, channels = Writer(file, **options), {}
            writer.start(profile="ros2")
            for schema, channel, message in make_reader(read).iter_messages():
                if channel.id not in channels:
                    known = writer.register_schema(schema.name, schema.encoding, schema.data)
                    channels[channel.id] = writer.register_channel(channel.topic, "cdr", known, channel.metadata)
                writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time)
            writer.finish()
        found[f"mcap, {name}"] = str(path)
    every = dict.fromkeys(("exclude_topics", "include_topics", "exclude_msgtypes", "include_msgtypes"), ())
    for name, storage, packing, mode in (
        ("SQLite", "sqlite3", None, "none"),
        ("SQLite with compressed files", "sqlite3", "zstd", "file"),
        ("SQLite with compressed messages", "sqlite3", "zstd", "message"),
        ("ROS 1", "", None, "none"),
        ("ROS 1 in BZ2", "", "bz2", "none"),
        ("ROS 1 in LZ4", "", "lz4", "none"),
    ):
        path, types = folder / (name if storage else f"{name}.bag"), None if storage else Stores.ROS1_NOETIC
        convert([source], path, storage, 8, packing, mode, STORE, types and get_typestore(types), **every)
        found[f"rosbags, {name}"] = str(path)
    return found


if __name__ == "__main__":
    print(json.dumps(globals()[sys.argv[1]](*sys.argv[2:])))

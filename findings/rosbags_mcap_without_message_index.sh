#!/usr/bin/env bash
# rosbags 0.11.9: an MCAP file with chunks and no message index gives no messages, and no error.
#
# The index of messages within a chunk is optional in MCAP; writers leave it out to save space. `AnyReader` then
# announces the messages (`message_count`, from the statistics) and yields none of them. With the index, or without
# chunks, the same writer's file is read whole. Compare the number of messages read with the number announced.
#
# Seen: {"chunks and index": [3, 3], "chunks, no message index": [3, 0], "no chunks": [3, 3]} (announced, read)
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3.11 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet rosbags==0.11.9 mcap==1.6.0
"$folder/venv/bin/python" - "$folder" <<'PYTHON'
import json
import sys
from pathlib import Path

from mcap.writer import IndexType, Writer
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

store, kind = get_typestore(Stores.ROS2_JAZZY), "std_msgs/msg/String"
variants = {
    "chunks and index": {"index_types": IndexType.ALL},
    "chunks, no message index": {"index_types": IndexType.ALL & ~IndexType.MESSAGE},
    "no chunks": {"use_chunking": False},
}
found = {}
for name, options in variants.items():
    path = Path(sys.argv[1], "drive.mcap")
    with path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start(profile="ros2")
        schema = writer.register_schema(kind, "ros2msg", store.generate_msgdef(kind, ros_version=2)[0].encode())
        channel = writer.register_channel("/chatter", "cdr", schema)
        for time in (1, 2, 3):
            message = bytes(store.serialize_cdr(store.types[kind](str(time)), kind))
            writer.add_message(channel, time * 10**9, message, time * 10**9)
        writer.finish()
    with AnyReader([path], default_typestore=store) as reader:
        found[name] = [reader.message_count, len(list(reader.messages()))]
print(json.dumps(found))
sys.exit(found != {"chunks and index": [3, 3], "chunks, no message index": [3, 0], "no chunks": [3, 3]})
PYTHON

#!/usr/bin/env bash
# rosbags 0.11.9: one channel with a JSON or protobuf schema makes a whole MCAP file unreadable.
#
# MCAP allows several encodings in one file, and Foxglove's tools write such files. `AnyReader.open` raises KeyError
# with the name of the schema's encoding ("jsonschema", "protobuf"), though the channels of the other topics hold
# ordinary ROS 2 messages. A channel with the message encoding "json" and no schema does no harm. A reader has to skip
# these schemas itself, before `open` looks at them.
#
# Seen: {"none": "['/chatter']", "jsonschema": "KeyError: 'jsonschema'", "protobuf": "KeyError: 'protobuf'",
#        "no schema": "['/battery', '/chatter']"}
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3.11 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet rosbags==0.11.9 mcap==1.6.0
"$folder/venv/bin/python" - "$folder" <<'PYTHON'
import json
import sys
from pathlib import Path

from mcap.writer import Writer
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

store, kind = get_typestore(Stores.ROS2_JAZZY), "std_msgs/msg/String"


def write(path, other):
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        if other != "none":
            schema = 0 if other == "no schema" else writer.register_schema("Battery", other, b"{}" * (other == "jsonschema"))
            channel = writer.register_channel("/battery", "protobuf" if other == "protobuf" else "json", schema)
            writer.add_message(channel, 10**9, b"{}", 10**9)
        schema = writer.register_schema(kind, "ros2msg", store.generate_msgdef(kind, ros_version=2)[0].encode())
        message = bytes(store.serialize_cdr(store.types[kind]("good"), kind))
        writer.add_message(writer.register_channel("/chatter", "cdr", schema), 10**9, message, 10**9)
        writer.finish()


found = {}
for other in ("none", "jsonschema", "protobuf", "no schema"):
    path = Path(sys.argv[1], "drive.mcap")
    write(path, other)
    try:
        with AnyReader([path], default_typestore=store) as reader:
            found[other] = str([connection.topic for connection in reader.connections])
    except KeyError as error:
        found[other] = f"KeyError: {error}"
print(json.dumps(found))
expected = {
    "none": "['/chatter']",
    "jsonschema": "KeyError: 'jsonschema'",
    "protobuf": "KeyError: 'protobuf'",
    "no schema": "['/battery', '/chatter']",
}
sys.exit(found != expected)
PYTHON

#!/usr/bin/env bash
# rosbags 0.11.9 and mcap-ros2-support 0.6.0 read `byte` and `char` of the same ROS 2 message with opposite signs.
#
# In ROS 2, both types are unsigned (in IDL octet and uint8). A byte of 200 is -56 in rosbags and 200 in the reader of mcap;
# a char of 200 is 200 in rosbags and -56 in the reader of mcap. rosbags refuses to write a byte of 200. Values up to 127
# agree. A message of one's own has uint8, which both read and write as it is.
#
# Seen: {"rosbags": [-56, -56, 200, 200, 200], "mcap": [200, 200, -56, -56, 200],
#        "rosbags writes": "byte format requires -128 <= number <= 127"} (byte, byte[2], char, char[2], uint8: all are 200)
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3.11 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet rosbags==0.11.9 mcap==1.6.0 mcap-ros2-support==0.6.0
"$folder/venv/bin/python" - "$folder/values.mcap" <<'PYTHON'
import json
import struct
import sys
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

path, names = Path(sys.argv[1]), ("byte_value", "byte_array", "char_value", "char_array", "uint8_value")
with path.open("wb") as file:
    writer = Writer(file)
    writer.start(profile="ros2")
    text = b"byte byte_value\nbyte[2] byte_array\nchar char_value\nchar[2] char_array\nuint8 uint8_value\n"
    schema = writer.register_schema("example_msgs/msg/Values", "ros2msg", text)
    channel = writer.register_channel("/values", "cdr", schema)
    writer.add_message(channel, 1, bytes([0, 1, 0, 0]) + bytes([200] * 7), 1)
    writer.finish()


def values(message):
    fields = (getattr(message, name) for name in names)
    return [int(field[0] if hasattr(field, "__len__") else field) for field in fields]


found = {}
store, kind = get_typestore(Stores.ROS2_JAZZY), "std_msgs/msg/Byte"
with AnyReader([path], default_typestore=store) as reader:
    [(connection, _, raw)] = reader.messages()
    found["rosbags"] = values(reader.deserialize(raw, connection.msgtype))
with path.open("rb") as file:
    [(_, _, _, message)] = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
    found["mcap"] = values(message)
try:
    found["rosbags writes"] = bytes(store.serialize_cdr(store.types[kind](200), kind)).hex()
except struct.error as error:
    found["rosbags writes"] = str(error)
print(json.dumps(found))
expected = {
    "rosbags": [-56, -56, 200, 200, 200],
    "mcap": [200, 200, -56, -56, 200],
    "rosbags writes": "byte format requires -128 <= number <= 127",
}
sys.exit(found != expected)
PYTHON

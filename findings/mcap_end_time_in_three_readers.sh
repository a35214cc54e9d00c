#!/usr/bin/env bash
# @mcap/core 2.2.2 includes the message at the end time of a query; mcap 1.6.0 and rosbags 0.11.9 leave it out.
#
# A part of a drive, from 2 s to 3 s, has the scans at 2 s and 3 s in a web page, and one scan less in Python. Parts that
# follow one another (1 to 2 s, 2 to 3 s) hold the scan between them twice in JavaScript, and once in Python. The start is
# included by all. A program that compares both passes the end time minus one nanosecond to the one of JavaScript.
#
# Seen: {"mcap": [2], "rosbags": [2], "@mcap/core": [2, 3]} (messages from 2 s to 3 s, of one per second)
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3.11 -m venv venv
venv/bin/pip install --quiet rosbags==0.11.9 mcap==1.6.0
echo '{"private": true, "type": "module"}' > package.json
npm install --silent --no-audit --no-fund --ignore-scripts @mcap/core@2.2.2
cat > read.mjs <<'JS'
import { open } from "node:fs/promises";
import { McapIndexedReader } from "@mcap/core";

const file = await open("drive.mcap");
const readable = {
  size: async () => BigInt((await file.stat()).size),
  read: async (offset, length) => {
    const buffer = Buffer.alloc(Number(length));
    await file.read(buffer, 0, Number(length), Number(offset));
    return new Uint8Array(buffer);
  },
};
const reader = await McapIndexedReader.Initialize({ readable });
const seconds = [];
for await (const message of reader.readMessages({ startTime: 2_000_000_000n, endTime: 3_000_000_000n }))
  seconds.push(Number(message.logTime / 1_000_000_000n));
console.log(JSON.stringify(seconds));
JS
venv/bin/python - <<'PYTHON'
import json
import subprocess
import sys
import warnings
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

store, kind, path = get_typestore(Stores.ROS2_JAZZY), "std_msgs/msg/String", Path("drive.mcap")
with path.open("wb") as file:
    writer = Writer(file, compression=CompressionType.NONE)
    writer.start(profile="ros2")
    schema = writer.register_schema(kind, "ros2msg", store.generate_msgdef(kind, ros_version=2)[0].encode())
    channel = writer.register_channel("/chatter", "cdr", schema)
    for second in (1, 2, 3, 4):
        message = bytes(store.serialize_cdr(store.types[kind](str(second)), kind))
        writer.add_message(channel, second * 10**9, message, second * 10**9)
    writer.finish()
warnings.simplefilter("ignore", DeprecationWarning)  # of the names of the arguments
with path.open("rb") as file:
    messages = make_reader(file).iter_messages(start_time=2 * 10**9, end_time=3 * 10**9)
    found = {"mcap": [message.log_time // 10**9 for _, _, message in messages]}
with AnyReader([path], default_typestore=store) as reader:
    found["rosbags"] = [time // 10**9 for _, time, _ in reader.messages(start=2 * 10**9, stop=3 * 10**9)]
found["@mcap/core"] = json.loads(subprocess.run(["node", "read.mjs"], capture_output=True, check=True).stdout)
print(json.dumps(found))
sys.exit(found != {"mcap": [2], "rosbags": [2], "@mcap/core": [2, 3]})
PYTHON

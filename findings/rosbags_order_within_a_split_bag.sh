#!/usr/bin/env bash
# rosbags 0.11.9: messages of one split bag are not in time order if its files overlap; those of two bags are.
#
# `AnyReader` merges the messages of several paths by time. The files of one folder with metadata.yaml are read one
# after the other instead, although their `starting_time` and `duration` overlap, as they do where recorders with
# several writers split bags. A reader that needs time order has to merge the files itself.
#
# Seen: {"files of one bag": [1, 3, 5, 2, 4, 6], "two bags": [1, 2, 3, 4, 5, 6]} (times of messages [s], as read)
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3.11 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet rosbags==0.11.9 pyyaml==6.0.3
"$folder/venv/bin/python" - "$folder" <<'PYTHON'
import json
import shutil
import sys
from pathlib import Path

import yaml
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

store, kind, folder = get_typestore(Stores.ROS2_JAZZY), "std_msgs/msg/String", Path(sys.argv[1])
for name, times in (("a", (1, 3, 5)), ("b", (2, 4, 6))):
    with Writer(folder / name, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/chatter", kind, typestore=store)
        for time in times:
            writer.write(connection, time * 10**9, store.serialize_cdr(store.types[kind](str(time)), kind))
split = folder / "split"
split.mkdir()
metadata = yaml.safe_load((folder / "a" / "metadata.yaml").read_text())
about = metadata["rosbag2_bagfile_information"]
about["relative_file_paths"], about["files"] = ["split_0.mcap", "split_1.mcap"], []
about["message_count"] = about["topics_with_message_count"][0]["message_count"] = 6
about["duration"]["nanoseconds"] = 5 * 10**9
for k, name in enumerate("ab"):
    shutil.copy(folder / name / f"{name}.mcap", split / f"split_{k}.mcap")
    span = {"starting_time": {"nanoseconds_since_epoch": (k + 1) * 10**9}, "duration": {"nanoseconds": 4 * 10**9}}
    about["files"].append({"path": f"split_{k}.mcap", "message_count": 3, **span})
(split / "metadata.yaml").write_text(yaml.safe_dump(metadata))


def times_of(*paths):
    with AnyReader(list(paths), default_typestore=store) as reader:
        return [time // 10**9 for _, time, _ in reader.messages()]


found = {"files of one bag": times_of(split), "two bags": times_of(folder / "a", folder / "b")}
print(json.dumps(found))
sys.exit(found != {"files of one bag": [1, 3, 5, 2, 4, 6], "two bags": [1, 2, 3, 4, 5, 6]})
PYTHON

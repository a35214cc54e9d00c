#!/usr/bin/env bash
# roslibpy 2.1.0: `roslibpy.ros2.Header`, the header for ROS 2, takes and writes stamps of ROS 1 alone.
#
# `builtin_interfaces/msg/Time` of ROS 2 has the fields `sec` and `nanosec`. A header made from the stamp of a received
# message raises KeyError, and a header made from `Time.now()` is written with `secs` and `nsecs`. A header for ROS 2 is a
# plain dict: `{"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "map"}`.
#
# Seen: {"from ROS 2": "KeyError: 'secs'", "fields written": ["nsecs", "secs"]}
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3.11 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet roslibpy==2.1.0 autobahn==26.10.2 twisted==26.10.0
"$folder/venv/bin/python" - <<'PYTHON'
import json
import sys

from roslibpy import Time
from roslibpy.ros2 import Header

message = {"header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "map"}}
try:
    received = str(Header(stamp=message["header"]["stamp"], frame_id="map"))
except KeyError as error:
    received = f"KeyError: {error}"
found = {"from ROS 2": received, "fields written": sorted(Header(stamp=Time.now(), frame_id="map")["stamp"])}
print(json.dumps(found))
sys.exit(found != {"from ROS 2": "KeyError: 'secs'", "fields written": ["nsecs", "secs"]})
PYTHON

#!/usr/bin/env bash
# rosbags 0.11.9: ROS 1 bags compressed with LZ4 cannot be read by ROS 1 (roslz4 1.15.15, here Debian's of Debian 12).
#
# roslz4 reads only LZ4 frames with a checksum of the content, without its size, and of independent blocks. rosbags writes
# chunks by `lz4.frame.compress` with its defaults, the opposite of all three: rosbag of ROS 1 raises OSError ("malformed
# data to decompress"), also for bags of `rosbags-convert --compress lz4`. rosbags and @foxglove/rosbag read them. Write BZ2
# or no compression for ROS 1.
#
# Seen: {"chunk of rosbags": "refused", "lz4.frame": "refused", "with checksum": "refused", "with checksum, no size":
#        "refused", "with checksum, no size, independent blocks": "103000 bytes"}
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3.11 -m venv venv
venv/bin/pip install --quiet rosbags==0.11.9 lz4==4.4.5
apt-get download -qq libroslz4-1d=1.15.15+ds-2 python3-roslz4=1.15.15+ds-2 2> apt.log || { cat apt.log; exit 1; }
for package in *.deb; do dpkg --extract "$package" debian; done
venv/bin/python - <<'PYTHON'
import struct
from pathlib import Path

import lz4.frame
import numpy as np
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

data = np.random.default_rng(0).bytes(3000) + bytes(100_000)
options = {}
for name, option in (
    ("lz4.frame", {}),
    ("with checksum", {"content_checksum": True}),
    ("with checksum, no size", {"store_size": False}),
    ("with checksum, no size, independent blocks", {"block_linked": False}),
):
    options |= option
    Path(f"{name}.lz4").write_bytes(lz4.frame.compress(data, **options))
store, kind = get_typestore(Stores.ROS1_NOETIC), "std_msgs/msg/String"
writer = Writer(Path("drive.bag"))
writer.set_compression(Writer.CompressionFormat.LZ4)
with writer:
    connection = writer.add_connection("/chatter", kind, typestore=store)
    writer.write(connection, 10**9, store.serialize_ros1(store.types[kind]("good"), kind))
bag = Path("drive.bag").read_bytes()
start = bag.index(struct.pack("<I", 0x184D2204))  # the magic number of an LZ4 frame
(size,) = struct.unpack("<I", bag[start - 4 : start])
Path("chunk of rosbags.lz4").write_bytes(bag[start : start + size])
PYTHON
libraries=$(echo debian/usr/lib/*-linux-gnu*)
PYTHONPATH=debian/usr/lib/python3/dist-packages LD_LIBRARY_PATH="$libraries" /usr/bin/python3 - <<'PYTHON'
import json
import sys
from pathlib import Path

import roslz4

expected = {"chunk of rosbags": "refused", "lz4.frame": "refused", "with checksum": "refused"}
expected |= {"with checksum, no size": "refused", "with checksum, no size, independent blocks": "103000 bytes"}
found = {}
for name in expected:
    try:
        found[name] = f"{len(roslz4.decompress(Path(f'{name}.lz4').read_bytes()))} bytes"
    except OSError as error:
        assert "malformed data to decompress" in str(error)
        found[name] = "refused"
print(json.dumps(found))
sys.exit(found != expected)
PYTHON

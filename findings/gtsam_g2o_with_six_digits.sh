#!/usr/bin/env bash
# gtsam 4.3.0: writeG2o keeps six significant digits, so that poses in map coordinates move by up to metres.
#
# Poses in UTM coordinates, 0.5 m apart, are written as `512346 5.40321e+06`, and read back 0.3 m off and at one place.
# Measurements and angles lose digits in the same way (1.23456789 m: 1.23457). Nothing is said. A program subtracts the
# first pose before it writes, or writes the file itself.
#
# Seen: {"written": "VERTEX_SE2 0 512346 5.40321e+06 0.123457", "distance": [0.5, 0.0], "moved": 0.34}
#       (distance of two poses [m] before and after; move of the first [m])
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3.11 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --no-deps gtsam==4.3.0 numpy==2.4.6
"$folder/venv/bin/python" - "$folder/graph.g2o" <<'PYTHON'
import json
import math
import sys
from pathlib import Path

import gtsam

path, poses = sys.argv[1], gtsam.Values()
for k in range(2):
    poses.insert(k, gtsam.Pose2(512345.678 + 0.5 * k, 5403210.123, 0.123456789))
gtsam.writeG2o(gtsam.NonlinearFactorGraph(), poses, path)
_, read = gtsam.readG2o(path)


def distance(a, b):
    return math.hypot(a.x() - b.x(), a.y() - b.y())


found = {
    "written": Path(path).read_text().splitlines()[0],
    "distance": [round(distance(values.atPose2(0), values.atPose2(1)), 3) for values in (poses, read)],
    "moved": round(distance(poses.atPose2(0), read.atPose2(0)), 2),
}
print(json.dumps(found))
sys.exit(found != {"written": "VERTEX_SE2 0 512346 5.40321e+06 0.123457", "distance": [0.5, 0.0], "moved": 0.34})
PYTHON

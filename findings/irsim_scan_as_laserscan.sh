#!/usr/bin/env bash
# ir-sim 2.12.0: a scan of a full turn has its first direction twice, and in a LaserScan open space is a wall at range_max.
#
# `angle_range: 6.2832` with 8 beams gives directions of -180, -129, ..., 129, 180 degrees: seven different ones, 51.4 degrees
# apart instead of 45, and none ahead. A lidar driver with 8 beams has an `angle_increment` of 45 degrees. Beams without a
# return have `range_max`, which is a return in `sensor_msgs/LaserScan` (REP 117: no return is inf), so that SLAM draws a
# circle around the robot. `valid` of the scan tells them apart. Set `angle_range` to 2 pi (n - 1) / n, and replace ranges
# that are not valid by inf.
#
# Seen: {"degrees": [-180, -129, -77, -26, 26, 77, 129, 180], "ranges": [1.5, 3.0, 3.0, 3.0, 3.0, 3.0, 3.0, 1.5],
#        "valid": [0, 7]} (a pillar 1.5 m behind the robot; range_max is 3 m)
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
export MPLCONFIGDIR="$folder" MPLBACKEND=Agg
python3.11 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet ir-sim==2.12.0 numpy==2.4.6
cat > "$folder/world.yaml" <<'YAML'
world: {width: 10, height: 10, step_time: 0.1}
robot:
  - kinematics: {name: diff}
    shape: {name: circle, radius: 0.2}
    state: [5, 5, 0]
    goal: [9, 9, 0]
    sensors: [{name: lidar2d, range_min: 0.1, range_max: 3.0, angle_range: 6.283185307, number: 8}]
obstacle:
  - shape: {name: circle, radius: 0.5}
    state: [3, 5, 0]
YAML
"$folder/venv/bin/python" - "$folder/world.yaml" <<'PYTHON'
import json
import sys

import irsim
import numpy as np

env = irsim.make(sys.argv[1], headless=True, log_level="ERROR")
env.step([0.0, 0.0])
scan = env.get_lidar_scan()
angles = scan["angle_min"] + scan["angle_increment"] * np.arange(8)
found = {
    "degrees": np.rint(np.degrees(angles)).astype(int).tolist(),
    "ranges": np.round(scan["ranges"], 2).tolist(),
    "valid": np.flatnonzero(scan["valid"]).tolist(),
}
print(json.dumps(found))
expected = {
    "degrees": [-180, -129, -77, -26, 26, 77, 129, 180],
    "ranges": [1.5, 3.0, 3.0, 3.0, 3.0, 3.0, 3.0, 1.5],
    "valid": [0, 7],
}
sys.exit(found != expected)
PYTHON

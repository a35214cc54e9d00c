#!/usr/bin/env bash
# ir-sim 2.12.0: an obstacle without `state` is moved by (1, 1) m, also a wall whose vertices are given in the world.
#
# The default of `state` is [1, 1, 0], and the vertices of a `linestring` or `polygon` are relative to it. A world of
# 10 m x 10 m with a line along its limits has its walls at 1 m and 11 m, and no message says so. Write
# `state: [0, 0, 0]` for walls in coordinates of the world.
#
# Seen: {"without state": [1.0, 1.0, 11.0, 11.0], "with state": [0.0, 0.0, 10.0, 10.0]} (bounds of the wall)
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
export MPLCONFIGDIR="$folder" MPLBACKEND=Agg
python3.11 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet ir-sim==2.12.0 numpy==2.4.6
"$folder/venv/bin/python" - "$folder" <<'PYTHON'
import json
import sys
from pathlib import Path

import irsim
import shapely

wall = {"shape": {"name": "linestring", "vertices": [[0, 0], [10, 0], [10, 10], [0, 10], [0, 0]]}}
found = {}
for name, obstacle in {"without state": wall, "with state": wall | {"state": [0, 0, 0]}}.items():
    robot = {"kinematics": {"name": "diff"}, "shape": {"name": "circle", "radius": 0.2}, "state": [5, 5, 0]}
    path = Path(sys.argv[1]) / "world.yaml"
    path.write_text(json.dumps({"world": {"width": 10, "height": 10}, "robot": [robot], "obstacle": [obstacle]}))
    env = irsim.make(str(path), headless=True, log_level="ERROR")
    env.step([0.0, 0.0])
    found[name] = shapely.bounds(env.obstacle_list[0].geometry).round(6).tolist()
print(json.dumps(found))
sys.exit(found != {"without state": [1.0, 1.0, 11.0, 11.0], "with state": [0.0, 0.0, 10.0, 10.0]})
PYTHON

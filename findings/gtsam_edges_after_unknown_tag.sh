#!/usr/bin/env bash
# gtsam 4.3.0: readG2o reads the edges of a g2o file only up to the first line whose tag it does not know.
#
# `FIX 0`, which g2o itself writes to hold a vertex, is such a tag, and so is a comment (`# ...`). Vertices behind the
# line are read, edges are not, and nothing is said: a graph of 4 poses and 3 edges has 4 values and no factor, whether
# the line stands first or between vertices and edges. The same line behind the last edge costs nothing. A writer puts
# `FIX` last, and writes no comments.
#
# Seen: {"behind the edges": [3, 4], "before the edges": [0, 4], "first": [0, 4], "comment": [0, 4], "blank line": [3, 4]}
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3.11 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --no-deps gtsam==4.3.0 numpy==2.4.6
"$folder/venv/bin/python" - "$folder/graph.g2o" <<'PYTHON'
import json
import sys
from pathlib import Path

import gtsam

vertices = "".join(f"VERTEX_SE2 {k} {k} 0 0\n" for k in range(4))
edges = "".join(f"EDGE_SE2 {k} {k + 1} 1 0 0 500 0 0 500 0 5000\n" for k in range(3))
texts = {
    "behind the edges": vertices + edges + "FIX 0\n",
    "before the edges": vertices + "FIX 0\n" + edges,
    "first": "FIX 0\n" + vertices + edges,
    "comment": vertices + "# odometry\n" + edges,
    "blank line": vertices + "\n" + edges,
}
found = {}
for name, text in texts.items():
    Path(sys.argv[1]).write_text(text)
    graph, values = gtsam.readG2o(sys.argv[1])
    found[name] = [graph.size(), values.size()]
print(json.dumps(found))
expected = {name: [0 if name in ("before the edges", "first", "comment") else 3, 4] for name in texts}
sys.exit(found != expected)
PYTHON

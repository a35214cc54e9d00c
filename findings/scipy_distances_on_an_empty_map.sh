#!/usr/bin/env bash
# scipy 1.17.1: distance_transform_edt of a map without an obstacle gives distances to a cell outside of the map.
#
# The distance of each free cell to the nearest obstacle is the transform of `map == free`. Without any obstacle, no
# distance is defined; expected are infinite ones, or an error. The result has finite distances to the cell (-1, 0), next
# to a corner, as from a wall there. `distance_transform_cdt` gives -1, and `distance_transform_bf` 1.3e154. A program asks
# `(map != free).any()` first.
#
# Seen: {"edt": [[1.0, 1.414, 2.236], [2.0, 2.236, 2.828]], "nearest": [[-1, 0]], "cdt": [-1]}
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3.11 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet scipy==1.17.1 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import json
import sys

import numpy as np
from scipy.ndimage import distance_transform_cdt, distance_transform_edt

free = np.ones((2, 3), dtype=bool)
distances, nearest = distance_transform_edt(free, return_indices=True)
found = {
    "edt": distances.round(3).tolist(),
    "nearest": np.unique(nearest.reshape(2, -1).T, axis=0).tolist(),
    "cdt": np.unique(distance_transform_cdt(free)).tolist(),
}
print(json.dumps(found))
sys.exit(found != {"edt": [[1.0, 1.414, 2.236], [2.0, 2.236, 2.828]], "nearest": [[-1, 0]], "cdt": [-1]})
PYTHON

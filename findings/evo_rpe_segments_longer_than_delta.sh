#!/usr/bin/env bash
# evo 1.38.1: the relative pose error "per metre" of a sparse trajectory is that of longer segments, without a warning.
#
# With `delta=1.0` and `Unit.meters`, a segment ends at the first pose at least 1 m on. Key frames 0.7 m apart give
# segments of 1.4 m, and an estimate with a scale error of 10 % has an error of 0.14 m "per metre" instead of 0.1 m;
# 0.9 m apart, 0.18 m. `rel_delta_tol` (10 %) is not applied to consecutive pairs, the default. With `all_pairs=True` it is,
# and the same trajectory is refused. Interpolate to a fine spacing first, or divide by the length of each segment.
#
# Seen: {"0.1 m apart": [0.1, 0.1], "0.7 m apart": [0.14, "FilterException"], "0.9 m apart": [0.18, 0.09]}
#       (mean error [m] of consecutive pairs, and of all pairs)
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
export HOME="$folder"
python3.11 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet evo==1.38.1 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import json
import sys

import numpy as np
from evo.core.filters import FilterException
from evo.core.metrics import RPE, PoseRelation, StatisticsType, Unit
from evo.core.trajectory import PosePath3D


def path(step):
    x = step * np.arange(60)
    return PosePath3D(np.stack([x, 0 * x, 0 * x], axis=1), np.tile([1.0, 0.0, 0.0, 0.0], (60, 1)))


found = {}
for step in (0.1, 0.7, 0.9):
    # Lengths are those of the true path: the scale error must not change the segments.
    data, results = (path(step), path(1.1 * step)), []
    for all_pairs in (False, True):
        metric = RPE(PoseRelation.translation_part, 1.0, Unit.meters, all_pairs=all_pairs, pairs_from_reference=True)
        try:
            metric.process_data(data)
            results.append(round(float(metric.get_statistic(StatisticsType.mean)), 3))
        except FilterException:
            results.append("FilterException")
    found[f"{step} m apart"] = results
print(json.dumps(found))
expected = {"0.1 m apart": [0.1, 0.1], "0.7 m apart": [0.14, "FilterException"], "0.9 m apart": [0.18, 0.09]}
sys.exit(found != expected)
PYTHON

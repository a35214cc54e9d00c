#!/usr/bin/env bash
# minari 0.5.4: an observation of the shape (48, 48) and type uint8, such as a costmap, is stored as a lossy JPEG image.
#
# A map with the values 0 (free), 100 (unknown) and 255 (occupied) comes back with over a hundred values; more than half of
# its cells differ. Nothing is said at run time. Spaces count as images if they are of uint8 with the limits 0 and 255, and at least
# 32 x 32. A map of 31 x 31 cells, or one with the upper limit 254, is stored as it is. Pass `jpeg_encoding=False` to
# `DataCollector`, or give the space other limits.
#
# Seen: {"as it is": false, "jpeg_encoding=False": true, "31 x 31": true, "limit 254": true} (equal after reading)
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
export MINARI_DATASETS_PATH="$folder/datasets"
python3.11 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet "minari[create,hdf5]==0.5.4" gymnasium==1.2.2 pillow==13.0.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import json
import sys
import warnings

import gymnasium
import minari
import numpy as np

warnings.simplefilter("ignore")  # the environment has no spec


class Costmap(gymnasium.Env):
    def __init__(self, size, high):
        self.observation_space = gymnasium.spaces.Box(0, high, (size, size), np.uint8)
        self.action_space = gymnasium.spaces.Discrete(2)
        values = np.array([0, 100, high], dtype=np.uint8)
        self.map = np.random.default_rng(0).choice(values, (size, size))

    def reset(self, seed=None, options=None):
        return self.map.copy(), {}

    def step(self, action):
        return self.map.copy(), 0.0, True, False, {}


cases = {"as it is": (48, 255, {}), "jpeg_encoding=False": (48, 255, {"jpeg_encoding": False})}
cases |= {"31 x 31": (31, 255, {}), "limit 254": (48, 254, {})}
found = {}
for k, (name, (size, high, options)) in enumerate(cases.items()):
    env = minari.DataCollector(Costmap(size, high), **options)
    env.reset(seed=0)
    env.step(0)
    dataset = env.create_dataset(f"costmap{k}-v0", eval_env="CartPole-v1")
    [episode] = dataset.iterate_episodes()
    found[name] = bool((episode.observations == env.unwrapped.map).all())
print(json.dumps(found))
sys.exit(found != {"as it is": False, "jpeg_encoding=False": True, "31 x 31": True, "limit 254": True})
PYTHON

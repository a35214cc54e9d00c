#!/usr/bin/env bash
# stable-baselines3 2.9.2: schedules are called with a remaining progress below zero, and learning rates get negative.
#
# A schedule is a function of the remaining progress, documented to go from 1 to 0. A rollout is never cut, so that after
# the first rollout of `learn(total_timesteps=64)` with `n_steps=256` the progress is 1 - 256 / 64 = -3, and the update
# runs with the learning rate `3e-4 * -3`: gradient ascent. Nothing is said. `learn(..., reset_num_timesteps=False)` adds
# the steps made so far to the total, and gives values below zero in the same way. A schedule of one's own clips its
# argument.
#
# Seen: {"progress": [1.0, -3.0], "learning_rate": -0.0009}
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3.11 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet stable-baselines3==2.9.2 torch==2.13.0 gymnasium==1.4.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import json
import sys

from stable_baselines3 import PPO

seen = []


def linear(progress):
    seen.append(progress)
    return 3e-4 * progress


model = PPO("MlpPolicy", "CartPole-v1", learning_rate=linear, n_steps=256, batch_size=64, n_epochs=1, device="cpu", seed=0)
model.learn(total_timesteps=64)
rate = model.policy.optimizer.param_groups[0]["lr"]
found = {"progress": sorted({round(float(one), 6) for one in seen}, reverse=True), "learning_rate": round(float(rate), 6)}
print(json.dumps(found))
sys.exit(found != {"progress": [1.0, -3.0], "learning_rate": -0.0009})
PYTHON

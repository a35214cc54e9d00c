#!/usr/bin/env bash
# stable-baselines3 2.9.2: `optimizer_kwargs` of a policy, whatever they hold, change Adam's epsilon from 1e-5 to 1e-8.
#
# Policies for PPO and A2C use Adam with an epsilon of 1e-5 (as the original implementation of PPO), but only while
# `policy_kwargs` has no `optimizer_kwargs`. A weight decay, or an empty mapping, also resets epsilon to the default of
# torch, a thousand times smaller. Who adds a setting of the optimizer has to repeat `eps=1e-5`.
#
# Seen: {"none": 1e-05, "{}": 1e-08, "{'weight_decay': 0.01}": 1e-08, "{'weight_decay': 0.01, 'eps': 1e-05}": 1e-05}
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3.11 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet stable-baselines3==2.9.2 torch==2.13.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import json
import sys

from stable_baselines3 import PPO

found = {"none": PPO("MlpPolicy", "CartPole-v1", device="cpu").policy.optimizer.defaults["eps"]}
for settings in ({}, {"weight_decay": 0.01}, {"weight_decay": 0.01, "eps": 1e-5}):
    model = PPO("MlpPolicy", "CartPole-v1", device="cpu", policy_kwargs={"optimizer_kwargs": settings})
    found[str(settings)] = model.policy.optimizer.defaults["eps"]
print(json.dumps(found))
sys.exit(list(found.values()) != [1e-5, 1e-8, 1e-8, 1e-5])
PYTHON

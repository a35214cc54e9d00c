#!/usr/bin/env bash
# skrl 2.1.1: the returns of PPO go on across a time limit into the next episode, unless `time_limit_bootstrap` is set.
#
# `time_limit_bootstrap` (False by default) is documented as bootstrapping at a time limit. Without it, a truncated step is
# no end: an episode with the rewards 1 and 1 that its time limit ends has the returns 202 and 201, if the next episode in
# the same environment has 100 and 100. With it, they are 2 and 1 (the value of the last observation is added to its
# reward elsewhere). Terminated episodes end either way. Set it for every environment with a time limit.
#
# Seen: {"False, truncated": [202.0, 201.0, 200.0, 100.0], "True, truncated": [2.0, 1.0, 200.0, 100.0],
#        "False, terminated": [2.0, 1.0, 200.0, 100.0], "default": false}
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3.11 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet skrl==2.1.1 torch==2.13.0 gymnasium==1.2.2 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import json
import sys

import torch
from skrl.agents.torch.ppo import PPO_CFG
from skrl.agents.torch.ppo.ppo import compute_gae

rewards = torch.tensor([[1.0], [1.0], [100.0], [100.0]])
ends, none = torch.tensor([[False], [True], [False], [True]]), torch.zeros(4, 1, dtype=torch.bool)


def returns(terminated, truncated, time_limit_bootstrap):
    values = {"values": torch.zeros(4, 1), "last_values": torch.zeros(1, 1)}
    found, _ = compute_gae(rewards=rewards, terminated=terminated, truncated=truncated, **values, discount_factor=1.0,
                           lambda_coefficient=1.0, time_limit_bootstrap=time_limit_bootstrap)  # fmt: skip
    return found.flatten().tolist()


found = {
    "False, truncated": returns(none, ends, False),
    "True, truncated": returns(none, ends, True),
    "False, terminated": returns(ends, none, False),
    "default": PPO_CFG().time_limit_bootstrap,
}
print(json.dumps(found))
expected = {
    "False, truncated": [202.0, 201.0, 200.0, 100.0],
    "True, truncated": [2.0, 1.0, 200.0, 100.0],
    "False, terminated": [2.0, 1.0, 200.0, 100.0],
    "default": False,
}
sys.exit(found != expected)
PYTHON
